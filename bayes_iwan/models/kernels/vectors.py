"""Two things that numba cannot say to LLVM, said by one call at the head of a compiled function."""

from collections.abc import Callable

from llvmlite import ir
from numba import types
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
#: nothing changes. Without both the sliders take 1.10 times as long, a whole call 1.06 (an AMD EPYC with AVX-512,
#: analyses/benchmark_side_by_side.py against a tree without them). A function inlined into
#: another keeps what it said of its arrays, and its loops.
apart_and_wide: Callable[[], None] = intrinsic(_apart_and_wide)  # type: ignore[assignment]
