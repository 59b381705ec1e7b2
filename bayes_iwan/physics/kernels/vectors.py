"""What numba does not say to LLVM by itself, said by a call at the head of a compiled function and by its compiler."""

from __future__ import annotations

from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.core import config
from numba.core.compiler import Compiler
from numba.extending import intrinsic


def _apart_and_wide(typing_context):
    def generate(context, builder, signature, arguments):
        function = builder.function
        set.add(function.attributes, '"prefer-vector-width"="512"')  # llvmlite lets only names pass that it knows
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType):
                argument.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), generate


#: The calling function's arrays do not overlap where it writes, and its loops may use vectors of 512 bits. Without the
#: first, a loop that reads a table at places of its own choosing is never done in vectors, and every other loop first
#: compares the addresses of its arrays. LLVM's habit is 256 bits even where the machine has 512; where it has not,
#: nothing changes. A function inlined into another keeps what it said of its arrays, and its loops.
apart_and_wide: Callable[[], None] = intrinsic(_apart_and_wide)  # type: ignore[assignment]


class InWords(Compiler):
    """A compiler (`pipeline_class` of `numba.njit`) that also makes vectors of neighbouring lines, not only of loops.

    numba leaves that out since an LLVM of old miscompiled it. The sliders take a fifth less time with it and give the
    same bits; tests against single elements and closed forms watch them.
    """

    def compile_extra(self, func):
        before = config.SLP_VECTORIZE  # type: ignore[attr-defined]
        config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]  # read while this compiles, under numba's own lock
        try:
            return super().compile_extra(func)
        finally:
            config.SLP_VECTORIZE = before  # type: ignore[attr-defined]
