"""What a robot of a delivering fleet says that it can do."""

from agent.interface.vehicle import Vehicle
from agent.runtime.vda5050.messages import (
    ACTIONS_MAX,
    ID_CHARS_MAX,
    MESSAGE_BYTES_MAX,
    NODES_MAX,
    AgvAction,
    Factsheet,
    LoadSpecification,
    OptionalParameter,
    PhysicalParameters,
    ProtocolFeatures,
    ProtocolLimits,
    Timing,
    TypeSpecification,
)

HEIGHT_M = 0.5  # of the robots of a simulated warehouse; nothing depends on it
INSTANT = {
    "stop": "an emergency stop of the whole fleet, as pressed on the bus; an operator releases it",
    "startPause": "this robot stands until stopPause",
    "stopPause": "this robot goes on",
    "cancelOrder": "the transport is taken back, unless the parcel is aboard",
    "stateRequest": "the state is published at once",
    "factsheetRequest": "the factsheet is published",
}


def factsheet_of(vehicle: Vehicle) -> Factsheet:
    """The factsheet of one robot of a fleet of this vehicle.

    It has no `blockingTypes`: the official schema of 2.1 refuses every list of them.
    """
    width_m = 2 * vehicle.radius_m
    actions = [
        AgvAction(
            action_type=kind, action_description=text, action_scopes=["INSTANT"],
        )
        for kind, text in INSTANT.items()
    ]  # fmt: skip
    actions += [AgvAction(action_type=kind, action_scopes=["NODE"]) for kind in ("pick", "drop")]
    return Factsheet(
        type_specification=TypeSpecification(
            series_name="Headland", series_description="a robot of a leaderless fleet",
            agv_kinematic="OMNI", agv_class="CARRIER", max_load_mass=0.0,
            localization_types=["NATURAL"], navigation_types=["AUTONOMOUS"],
        ),
        physical_parameters=PhysicalParameters(
            speed_min=0.0, speed_max=vehicle.speed_m_s, acceleration_max=vehicle.acceleration_m_s2,
            deceleration_max=vehicle.acceleration_m_s2, height_max=HEIGHT_M, width=width_m,
            length=width_m,
        ),
        protocol_limits=ProtocolLimits(
            max_string_lens={"msgLen": MESSAGE_BYTES_MAX, "idLen": ID_CHARS_MAX},
            max_array_lens={
                "order.nodes": NODES_MAX, "order.edges": NODES_MAX, "node.actions": ACTIONS_MAX,
                "edge.actions": 0, "instantActions": ACTIONS_MAX,
            },
            timing=Timing(
                min_order_interval=0.1, min_state_interval=0.1, default_state_interval=1.0,
                visualization_interval=0.5,
            ),
        ),
        protocol_features=ProtocolFeatures(
            optional_parameters=[
                OptionalParameter(parameter="order.nodes.nodePosition", support="REQUIRED"),
            ],
            agv_actions=actions,
        ),
        load_specification=LoadSpecification(load_positions=[]),
    )  # fmt: skip
