"""`njit` of every kernel of `agent/`: numba's own, or in a robot machine code that was made before.

numba with LLVM is 66 MB and half a second at the start of a process, and it takes more where it loads a
kernel. A robot needs none of it where its kernels are in a ready module. A simulation takes numba's
dispatchers themselves, so it pays nothing for this module.

A kernel in a ready module has one entry for each tuple of argument types that a rehearsal has seen. An
argument type that none has seen is compiled by numba then, with the same result.
"""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Final, ParamSpec, Protocol, TypeVar, cast

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
Kind = int | str | tuple[Any, ...]
Kinds = tuple[Kind, ...]
Entries = Mapping[Kinds, Callable[..., Any]]  # of one kernel

# Bits of `numpy.ndarray.flags.num`: in C order, in Fortran order, aligned, writable. numba types
# these apart, and compiled code relies on them.
C_ORDER, F_ORDER, ALIGNED, WRITABLE = 0x1, 0x2, 0x100, 0x400
NUMBERS_END: Final = 16  # numpy's type numbers below are bool, integers, floats and complex numbers
UNKNOWN: Final = "?"
# Scalars of numpy that numba types as Python's own.
SAME: Final = {"float64": "float", "int64": "int"}


class Source(Protocol):
    """Where kernels that were made before come from."""

    def entries(self, name: str) -> Entries:
        """The entries of a kernel, `module.function`."""

    def on_missing(self, kernel: "Kernel", kinds: Kinds, values: tuple[Any, ...]) -> None:
        """A kernel is called with types that have no entry; numba runs it."""


_source: Source | None = None


def take_from(source: Source | None) -> None:
    """Kernels of modules that are imported from now on come from `source`; None: from numba."""
    global _source
    _source = source


def njit(
    *, cache: bool = False, error_model: str = "python", inlined: bool = False
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """As numba's decorator.

    `inlined` is for a kernel that hot kernels call. numba counts the references of each array argument
    in atomic steps, which may take longer than the kernel. An inlined one counts none, so neither
    it nor a kernel that it calls may make an array, and it may return none.
    """
    options: dict[str, Any] = {"cache": cache, "error_model": error_model}
    if inlined:
        options |= {"forceinline": True, "_nrt": False}

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        if _source is None:
            import numba

            return numba.njit(**options)(function)
        kernel = Kernel(function, options, _source)
        return cast("Callable[P, R]", kernel)

    return decorate


class Kernel:
    """A kernel with entries by argument types. It takes no keywords, as a compiled function."""

    def __init__(
        self, function: Callable[..., Any], options: Mapping[str, Any], source: Source
    ) -> None:
        self.__wrapped__, self.__doc__ = function, function.__doc__
        self.options, self.source = options, source
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.entries = source.entries(self.name)

    def __call__(self, *values: Any) -> Any:
        kinds = tuple([kind_of(value) for value in values])
        entry = self.entries.get(kinds)
        if entry is not None:
            return entry(*values)
        self.source.on_missing(self, kinds, values)
        return self.dispatcher(*values)

    @cached_property
    def dispatcher(self) -> Any:
        """The kernel by numba."""
        return numba_knowing_kernels().njit(**self.options)(self.__wrapped__)


def kind_of(value: object) -> Kind:
    """What numba knows of the type of an argument, without numba; equal for equal types.

    Returns numpy's number of the element type, the number of axes and the flags of the memory in one
    integer for an array, a name for a scalar, a tuple of these for a tuple, and `UNKNOWN` for what no
    entry takes.
    """
    kind = type(value)
    if kind is np.ndarray:
        array = cast("np.ndarray[Any, Any]", value)
        dtype, flags = array.dtype, array.flags.num
        if dtype.num >= NUMBERS_END or not dtype.isnative:
            return UNKNOWN
        order = C_ORDER if flags & C_ORDER else flags & F_ORDER
        kinds: int = dtype.num << 16 | array.ndim << 12 | flags & (ALIGNED | WRITABLE) | order
        return kinds
    if isinstance(value, tuple):
        return (kind.__name__, *[kind_of(each) for each in value])
    return SAME.get(kind.__name__, kind.__name__)


def numba_knowing_kernels() -> Any:
    """numba, which compiles a `Kernel` where another kernel calls it."""
    import numba
    from numba.core.typing.typeof import typeof_impl

    if Kernel not in typeof_impl.registry:
        typeof_impl.register(Kernel)(lambda value, _: numba.types.Dispatcher(value.dispatcher))
    return numba
