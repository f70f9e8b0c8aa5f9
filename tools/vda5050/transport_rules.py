"""What a VDA 5050 order asks of a delivering fleet: to carry one parcel from one node to another.

The order may have any number of nodes. One of them has the action `pick`, and a later one `drop`; the
others are waypoints, which the fleet does not need, because its robots plan their own ways.
"""

from typing import NamedTuple

from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.runtime.vda5050.messages import (
    Action,
    ErrorLevel,
    ErrorReference,
    MasterOrder,
    OrderEdge,
    OrderNode,
    Topic,
    VehicleError,
)

PICK, DROP = "pick", "drop"
Ordered = OrderNode | OrderEdge


class OrderRefused(ValueError):
    """An order that cannot be carried out, as it is reported to the master."""

    def __init__(self, kind: str, why: str, *references: tuple[str, str]) -> None:
        """`kind`: the standard's name of the error. `references`: keys and values beside the order's."""
        super().__init__(why)
        self.kind, self.references = kind, references

    def error(self, order: MasterOrder) -> VehicleError:
        """What the state of the vehicle says about it."""
        references = (
            ("topic", str(Topic.ORDER)), ("orderId", order.order_id),
            ("orderUpdateId", str(order.order_update_id)), *self.references,
        )  # fmt: skip
        return VehicleError(
            error_type=self.kind, error_level=ErrorLevel.WARNING, error_description=str(self),
            error_references=[
                ErrorReference(reference_key=key, reference_value=value) for key, value in references
            ],
        )  # fmt: skip


class ParcelOrder(NamedTuple):
    """One parcel, and where in the order it is picked up and put down."""

    task: TransportTask
    pick: Action
    drop: Action
    pick_sequence: int  # sequenceId of the node
    drop_sequence: int


def in_order(order: MasterOrder) -> list[Ordered]:
    """Nodes and edges as they are travelled."""
    return sorted((*order.nodes, *order.edges), key=lambda each: each.sequence_id)


def by_sequence(order: MasterOrder) -> MasterOrder:
    """The same order with its lists as they are travelled: the standard numbers them, and a master may
    send them in any order."""
    nodes = sorted(order.nodes, key=lambda node: node.sequence_id)
    edges = sorted(order.edges, key=lambda edge: edge.sequence_id)
    return order.model_copy(update={"nodes": nodes, "edges": edges})


def check_graph(order: MasterOrder) -> None:
    """Raises OrderRefused if the nodes and edges of an order are not one path."""
    numbers = [each.sequence_id for each in in_order(order)]
    first = numbers[0]
    if len(order.nodes) != len(order.edges) + 1 or numbers != list(
        range(first, first + len(numbers))
    ):
        raise OrderRefused(
            "validationError",
            "sequenceIds of nodes and edges must be consecutive, nodes first and last",
        )
    nodes = {node.sequence_id: node.node_id for node in order.nodes}
    for edge in order.edges:
        ends = (nodes.get(edge.sequence_id - 1), nodes.get(edge.sequence_id + 1))
        if ends != (edge.start_node_id, edge.end_node_id):
            raise OrderRefused(
                "validationError", f"edge {edge.edge_id} does not join its neighbours",
                ("edgeId", edge.edge_id),
            )  # fmt: skip
    released = [each.released for each in in_order(order)]
    if not released[0] or sorted(released, reverse=True) != released:
        raise OrderRefused("validationError", "the base must come before the horizon")
    actions = [action.action_id for each in in_order(order) for action in each.actions]
    if len(set(actions)) != len(actions):
        raise OrderRefused("validationError", "two actions have one actionId")


def transport_of(order: MasterOrder, house: Warehouse, map_id: str) -> ParcelOrder | None:
    """The transport that an order asks for; None while its horizon hides a part of it.

    Raises OrderRefused.
    """
    check_graph(order)
    found: list[tuple[OrderNode, Action]] = []
    for each in in_order(order):
        for action in each.actions:
            if not isinstance(each, OrderNode) or action.action_type not in (PICK, DROP):
                raise OrderRefused(
                    "orderError", f"action {action.action_type} is not supported here",
                    ("actionId", action.action_id), ("actionType", action.action_type),
                )  # fmt: skip
            found.append((each, action))
    kinds = [action.action_type for _, action in found]
    complete = in_order(order)[-1].released
    if kinds != [PICK, DROP]:
        if not complete and kinds in ([], [PICK]):
            return None
        raise OrderRefused("orderError", "an order carries one parcel: one pick, then one drop")
    if not complete:
        return None
    (start, pick), (end, drop) = found
    task = TransportTask(_cell(start, house, map_id), _cell(end, house, map_id))
    return ParcelOrder(task, pick, drop, start.sequence_id, end.sequence_id)


def _cell(node: OrderNode, house: Warehouse, map_id: str) -> int:
    place = node.node_position
    if place is None:
        raise OrderRefused(
            "orderError", f"node {node.node_id} has no position", ("nodeId", node.node_id)
        )
    if place.map_id not in ("", map_id):
        raise OrderRefused(
            "orderError", f"map {place.map_id} is not known; this one is {map_id}",
            ("nodeId", node.node_id), ("mapId", place.map_id),
        )  # fmt: skip
    cell = house.cell((place.x, place.y))
    if cell is None:
        raise OrderRefused(
            "noRouteError", f"no robot can stand at {place.x:g}, {place.y:g}",
            ("nodeId", node.node_id),
        )  # fmt: skip
    return cell
