"""`headland launch`: a fleet of processes in real time, from what the command line says."""

import asyncio
import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from sim.files.strict_json import dumps
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError
from tools.build.kernel_cache import Compiling, told_compiling
from tools.build.warmup import warm
from tools.common.bus_address import AttachError
from tools.common.exit_codes import code_of, wrong
from tools.common.launch_keys import fleet_keys
from tools.common.run_folder import FolderError
from tools.inspect.metrics_address import MetricsError, metrics_address
from tools.livemap.command import ServerError, check_operator_key, listen
from tools.livemap.foxglove_port import PortTaken, check_port
from tools.run.fleet_folder import fleet_folder
from tools.run.launch import BusError, Launch
from tools.run.launch_delivery import HaulLaunch
from tools.run.launch_setup import setting_of


def launch(
    scenario: str, robots: int | None, seed: int | None, out: Path | None, port: int,
    seconds: float | None, as_json: bool, keys: Path | None = None, page_port: int | None = None,
    segment: int = 0, hub_port: int = 0, fresh: bool = False, operator_key: Path | None = None,
    metrics: str | None = None, foxglove: int | None = None, no_keys: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland launch`: 0 if all is done in truth, 1 if not, 2 for a wrong
    argument, 130 after Ctrl-C.

    `page_port`: of a map beside it. `hub_port`: of a bus that runs by itself. `out`: none, a folder
    named after the scenario. `fresh`: a new fleet, also where the last one is not done.
    `operator_key`: the map's page may release and start with it. `metrics`: PORT or HOST:PORT of figures
    for Prometheus. `foxglove`: a port for viewers. `no_keys`: any device may release this
    fleet; otherwise it has the keys of `keys`, those that its scenario names, or its own.
    """
    console = Console(stderr=as_json, highlight=False, soft_wrap=True)
    try:
        if no_keys and keys is not None:
            return wrong("--no-keys: with --keys it makes no sense; leave one of them out")
        setting = setting_of(scenario, robots, seed, keys)
        makes_own = setting.keys is None and not no_keys
        if makes_own and segment:
            return wrong(
                "--segment: all segments have the same keys: make them with 'headland keys new' and name "
                "them with --keys; or say --no-keys"
            )
        if no_keys and setting.keys is not None:
            return wrong(f"--no-keys: {scenario} names keys under [fleet]; leave one of them out")
        if segment and not isinstance(setting, FieldSetup):
            return wrong(
                f"--segment: {scenario} is a warehouse, and they are not bridged: leave it out"
            )
        if setting.scenario.fault:
            return wrong(
                f"{scenario}: [[fault]]: a launch has real processes and plays no faults; "
                "play this scenario with headland run"
            )
        if page_port is not None:
            listen(page_port).close()  # a port that is taken is reported before robots start
            check_operator_key(operator_key)
        if makes_own and operator_key is not None:
            return wrong(
                "--operator-key: of which fleet? Name the keys of its robots with --keys, too"
            )
        served = None if metrics is None else metrics_address(metrics)
        if foxglove is not None:
            check_port(foxglove)
        fleet = fleet_folder(out, setting, fresh, console.print)
        own = None
        if makes_own:
            own = fleet_keys(
                fleet.folder.absolute(), fleet.continues, setting.scenario.fleet.robots
            )
            setting.use_keys(own)
    except (
        ScenarioError,
        ServerError,
        FolderError,
        AttachError,
        MetricsError,
        PortTaken,
    ) as problem:
        return wrong(str(problem))
    except OSError as problem:
        return wrong(f"--out: {problem}", code_of(problem))
    if fleet.said:
        console.print(escape(fleet.said))
    # Here once, and not in every robot at the same time.
    with told_compiling(console.print), Compiling(console) as compiling:
        steering = isinstance(setting, FieldSetup) and setting.turn_radius_m > 0.0
        warm(steering, not isinstance(setting, FieldSetup), compiling.step)
    kind = Launch if isinstance(setting, FieldSetup) else HaulLaunch
    running = kind(setting, scenario, fleet, console, keys or own, page_port)
    operator_key = operator_key or own
    running.operator_key = None if operator_key is None else str(operator_key.absolute())
    running.own_keys = None if own is None else str(own)
    running.segment, running.hub_port = segment, hub_port
    running.metrics_address, running.foxglove_port = served, foxglove
    begun = time.monotonic()
    try:
        code = asyncio.run(running.run(port, seconds))
    except BusError as problem:
        if hub_port:
            return wrong(f"--hub {hub_port}: {problem}")
        return wrong(f"--port {port}: {problem}; choose another or 0 for any free one")
    except OSError as problem:
        return wrong(f"--out: {problem}", code_of(problem))
    finally:
        for lock in fleet.locks:
            lock.close()
    if as_json:
        print(dumps({**running.report, "wall_s": round(time.monotonic() - begun, 1)}))
    return code
