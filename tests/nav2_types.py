"""The types of Nav2's actions for rclpy, made from their definitions where nav2_msgs is not installed.

nav2_msgs is in no package index. The generators of ROS 2 are, and rclpy brings them along: from the
definition of an action they write what a C compiler makes a module of. So these are real types of
rclpy, with the hashes by which nodes of others know them.
"""

import atexit
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import mkdtemp

import pytest

PACKAGE = "nav2_msgs"
COMPILE_S = 300.0  # all at once, on a machine that has other work too
# Names and types of Nav2 1.3, which belongs to Jazzy.
GOAL_POSE = "geometry_msgs/PoseStamped pose\nstring behavior_tree"
GOAL_POSES = "geometry_msgs/PoseStamped[] poses\nstring behavior_tree"
RESULT = "uint16 NONE=0\nuint16 error_code"
FEEDBACK = """geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining"""
ACTIONS = {
    "NavigateToPose": (GOAL_POSE, RESULT, FEEDBACK),
    "NavigateThroughPoses": (
        GOAL_POSES, RESULT, FEEDBACK + "\nint16 number_of_poses_remaining",
    ),
}  # fmt: skip
USED = (
    "geometry_msgs", "std_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs",
    "service_msgs",
)  # fmt: skip
SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
# ROS opens the libraries of a package by name, and finds those that are loaded already.
INIT = f"""from ctypes import RTLD_GLOBAL, CDLL
from pathlib import Path

for name in {SUPPORTS}:
    CDLL(str(Path(__file__).parent / f"lib{PACKAGE}__{{name}}.so"), RTLD_GLOBAL)
"""
LIBRARIES = (
    "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c", "fastcdr", "rcutils", "rmw",
    *(f"{name}__{part}" for name in USED for part in (
        "rosidl_generator_c", "rosidl_typesupport_c", *SUPPORTS, "rosidl_generator_py",
    )),
)  # fmt: skip


def nav2_types() -> str:
    """Make nav2_msgs importable; the folder that has it, for the path of other processes.

    Skips the tests where it cannot be had. A process makes it once and keeps it, because what C
    libraries it has loaded cannot be taken back.
    """
    folder, problem = _found_or_made()
    if problem:
        pytest.skip(f"nav2_msgs is not installed, and cannot be made here: {problem}")
    return folder


@cache
def _found_or_made() -> tuple[str, str]:
    """The folder, or why there is none."""
    found = importlib.util.find_spec(PACKAGE)
    if found is not None and found.origin is not None:
        return str(Path(found.origin).parents[1]), ""
    for what in ("gcc", "g++"):
        if shutil.which(what) is None:
            return "", f"no {what}"
    folder = mkdtemp(prefix="headland-nav2-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    problem = _made(Path(folder))
    if not problem:
        sys.path.insert(0, folder)
    return folder, problem


def _made(folder: Path) -> str:
    """Make the package; what went wrong, or nothing."""
    python = Path(sysconfig.get_paths()["include"])
    if not (python / "Python.h").is_file():
        return "no headers of Python"
    before = os.environ.get("AMENT_PREFIX_PATH")
    os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    try:
        with redirect_stdout(StringIO()):  # the generators say what they write
            sources = _generated(folder)
    except ImportError as absent:
        return f"{absent.name} is not installed"
    finally:
        if before is None:
            del os.environ["AMENT_PREFIX_PATH"]
        else:
            os.environ["AMENT_PREFIX_PATH"] = before
    return _compiled(folder, sources, python)


def _generated(folder: Path) -> list[Path]:
    """Write the package's Python modules and its C and C++ sources; the sources."""
    import rosidl_typesupport_c
    import rosidl_typesupport_fastrtps_c
    import rosidl_typesupport_introspection_c
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash

    share, made, hashes = Path(sys.prefix) / "share", folder / "made", folder / "hashes"
    (folder / "action").mkdir()
    for name, parts in ACTIONS.items():
        file = Path("action") / f"{name}.action"
        (folder / file).write_text("\n---\n".join(parts) + "\n")
        convert_action_to_idl(folder, PACKAGE, file, folder / "idl" / "action")

    def told(tool: str, output: Path) -> str:
        file = folder / f"{tool}.json"
        file.write_text(json.dumps({
            "package_name": PACKAGE, "output_dir": str(output),
            "template_dir": str(share / tool / "resource"),
            "idl_tuples": [f"{folder / 'idl'}:action/{name}.idl" for name in ACTIONS],
            "ros_interface_files": [str(folder / f"action/{name}.action") for name in ACTIONS],
            "ros_interface_dependencies": [
                f"{name}:{idl}" for name in USED for idl in sorted((share / name).rglob("*.idl"))
            ],
            "target_dependencies": [],
            "include_paths": [f"{name}:{share / name}" for name in USED],
            "type_description_tuples": [
                f"action/{name}.idl:{hashes / 'action' / name}.json" for name in ACTIONS
            ],
        }))  # fmt: skip
        return str(file)

    generate_type_hash(told("rosidl_generator_type_description", hashes))

    def output(tool: str) -> str:
        """Each tool has its own folder: two of them write files of the same name."""
        return told(tool, made / tool / PACKAGE)

    generate_c(output("rosidl_generator_c"))
    _visibility(made / "rosidl_generator_c" / PACKAGE)
    fastrtps, introspection = SUPPORTS
    rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c(output(fastrtps))
    rosidl_typesupport_introspection_c.generate_c(output(introspection))
    rosidl_typesupport_c.generate_c(output("rosidl_typesupport_c"), list(SUPPORTS))
    generate_py(told("rosidl_generator_py", folder / PACKAGE), ["rosidl_typesupport_c"])
    (folder / PACKAGE / "__init__.py").write_text(INIT)
    return [
        *(folder / PACKAGE).rglob("*.c"),
        *(path for kind in ("*.c", "*.cpp") for path in made.rglob(kind)),
    ]


def _visibility(output: Path) -> None:
    """The headers that CMake would make: here all is in one library, so nothing is imported."""
    folder = output / "msg"
    folder.mkdir(exist_ok=True)
    for tool in ("rosidl_generator_c", *SUPPORTS):
        words = [f"{tool.upper()}_{word}_{PACKAGE}" for word in ("PUBLIC", "IMPORT", "EXPORT")]
        defined = "\n".join(f"#define {word}" for word in words)
        (folder / f"{tool}__visibility_control.h").write_text(f"#pragma once\n{defined}\n")


def _compiled(folder: Path, sources: list[Path], python: Path) -> str:
    """One library of all sources; what went wrong, or nothing."""
    prefix = Path(sys.prefix)
    places = [*(folder / "made").iterdir(), python, prefix / "include"]
    places += [path for path in (prefix / "include").iterdir() if path.is_dir()]
    import numpy

    flags = ["-fPIC", "-O0", "-w", *(f"-I{path}" for path in places), f"-I{numpy.get_include()}"]
    running = []
    objects = []
    for number, source in enumerate(sources):
        objects.append(folder / f"{number}.o")
        compiler = "g++" if source.suffix == ".cpp" else "gcc"
        words = [compiler, *flags, "-c", str(source), "-o", str(objects[-1])]
        running.append(subprocess.Popen(words, stderr=subprocess.PIPE, text=True))
    said = [process.communicate(timeout=COMPILE_S)[1] for process in running]
    if any(process.returncode for process in running):
        return next(text for text in said if text)
    python_part = [
        each for each, source in zip(objects, sources, strict=True) if _is_python(source)
    ]
    rest = [each for each in objects if each not in python_part]
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    built = [folder / PACKAGE / f"lib{PACKAGE}__{support}.so" for support in SUPPORTS]
    module = folder / PACKAGE / f"{PACKAGE}_s__rosidl_typesupport_c{suffix}"
    # All is in the first library. The second has but the name by which it is looked for.
    for library, parts in zip((*built, module), (rest, [], python_part), strict=True):
        words = ["g++", "-shared", "-o", str(library), f"-Wl,-soname,{library.name}"]
        words += [*map(str, parts), "-Wl,--no-as-needed"]
        words += [str(other) for other in built[:1] if other != library]
        words += [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}"]
        words += [f"-l{name}" for name in LIBRARIES]
        linked = subprocess.run(
            words, capture_output=True, text=True, timeout=COMPILE_S, check=False
        )
        if linked.returncode:
            return linked.stderr
    return ""


def _is_python(source: Path) -> bool:
    return source.name.endswith("_s.c") or ".ep." in source.name
