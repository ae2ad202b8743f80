"""Sixteen float32 side by side as one value that numba knows; LLVM makes of it what the processor has.

numba leaves vectorization to LLVM, which does not vectorize a butterfly that works in place: LLVM cannot know that the
rows which are read and written do not overlap. This module states it. With AVX-512 a value is one register, on
other processors two or four.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.extending import models, overload, register_model

COUNT = 16
_VECTOR = ir.VectorType(ir.FloatType(), COUNT)
_INDEX = ir.IntType(32)
_FUSED = ("contract", "nsz")
"""A product and a sum may become one instruction."""

Maker = Any
"""Result of a numba intrinsic: its signature, and the code that builds it."""


class Lanes(types.Type):
    """numba's type of such a value."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes({COUNT} x float32)")


LANES = Lanes()


def _intrinsic(function: Callable[..., Maker]) -> Any:
    """numba's, its type said."""
    return extending.intrinsic(function)


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


@_intrinsic
def load(_typing: Any, array: Any, _index: Any) -> Maker:
    """The value that begins at ``array[index]``; the array counts as flat."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _read(builder, _pointer(context, builder, signature.args[0], *args))

    return LANES(array, types.intp), code


@_intrinsic
def store(_typing: Any, array: Any, _index: Any, _value: Any) -> Maker:
    """Write a value from ``array[index]`` on."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        _write(builder, _pointer(context, builder, signature.args[0], *args[:2]), args[2])
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES), code


@_intrinsic
def loads(_typing: Any, array: Any, _row: Any, _step: Any, like: Any) -> Maker:
    """A tuple as long as ``like``: what is in rows ``row``, ``row + step``, ... of an array of (rows, COUNT)."""
    kind = types.UniTuple(LANES, len(like))

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _rows(context, builder, signature, args, len(like))
        return context.make_tuple(builder, kind, [_read(builder, place) for place in places])

    return kind(array, types.intp, types.intp, like), code


@_intrinsic
def stores(_typing: Any, array: Any, _row: Any, _step: Any, values: Any) -> Maker:
    """Write a tuple of values where `loads` would read them."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _rows(context, builder, signature, args, len(values))
        for place, value in zip(places, cgutils.unpack_tuple(builder, args[3]), strict=True):
            _write(builder, place, value)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, values), code


def _gathering(name: str) -> Any:
    @_intrinsic
    def found(_typing: Any, array: Any, _base: Any, first: Any, second: Any, _at: Any) -> Maker:
        kind = types.UniTuple(LANES, COUNT)

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pairs = zip(*_chosen(context, builder, signature, args), strict=True)
            rows = [getattr(builder, name)(_read(builder, p), _read(builder, q), flags=_FUSED) for p, q in pairs]
            return context.make_tuple(builder, kind, _transposed(builder, rows))

        return kind(array, types.intp, first, second, types.intp), code

    return found


gather_sum = _gathering("fadd")
"""(array, base, first, second, at): a square tile, transposed, of rows ``base + first[at:at + COUNT]`` of an array of
(rows, COUNT), plus that of ``base + second[...]``."""
gather_difference = _gathering("fsub")
"""Subtraction."""


@_intrinsic
def scatter(_typing: Any, array: Any, _base: Any, first: Any, second: Any, _at: Any, x: Any, y: Any) -> Maker:
    """Write tiles, transposed: ``x - y`` where `gather_sum` reads its first rows, ``x + y`` where its second."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        tiles = (_transposed(builder, cgutils.unpack_tuple(builder, tile)) for tile in args[5:])
        for p, q, a, b in zip(*_chosen(context, builder, signature, args), *tiles, strict=True):
            _write(builder, p, builder.fsub(a, b, flags=_FUSED))
            _write(builder, q, builder.fadd(a, b, flags=_FUSED))
        return context.get_dummy_value()

    return types.void(array, types.intp, first, second, types.intp, x, y), code


@_intrinsic
def splat(_typing: Any, _number: Any) -> Maker:
    """A number in all places."""
    return LANES(types.float32), lambda _context, builder, _signature, args: _splat(builder, args[0])


@_intrinsic
def splats(_typing: Any, array: Any, _index: Any, like: Any) -> Maker:
    """A tuple one shorter than ``like``: the numbers from ``array[index]`` on, each in all places."""
    kind = types.UniTuple(LANES, len(like) - 1)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        numbers = _numbers(context, builder, signature.args[0], args[0], args[1], len(like) - 1)
        return context.make_tuple(builder, kind, [_splat(builder, number) for number in numbers])

    return kind(array, types.intp, like), code


@_intrinsic
def rotate_complex(_typing: Any, x: Any, y: Any, cos: Any, sin: Any) -> Maker:
    """Tuples (x, y) of complex values, all but the first turned by the angles of which (cos, sin) are given."""

    def code(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        (a, *xs), (b, *ys), cs, ss = (cgutils.unpack_tuple(builder, each) for each in args)
        product = _signed("fmul")
        real = [a] + [
            _signed("fsub")(builder, product(builder, x, c), product(builder, y, s))
            for x, y, c, s in zip(xs, ys, cs, ss, strict=True)
        ]
        imaginary = [b] + [
            _signed("fadd")(builder, product(builder, x, s), product(builder, y, c))
            for x, y, c, s in zip(xs, ys, cs, ss, strict=True)
        ]
        both = [context.make_tuple(builder, kind, part) for kind, part in ((x, real), (y, imaginary))]
        return context.make_tuple(builder, types.UniTuple(x, 2), both)

    return types.UniTuple(x, 2)(x, y, cos, sin), code


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    if kind.layout != "C" or kind.dtype != types.float32:
        raise TypeError(f"{kind}: lanes are read and written in C-contiguous arrays of float32 only")
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


def _read(builder: Any, pointer: Any) -> Any:
    return builder.load(pointer, align=4)


def _write(builder: Any, pointer: Any, value: Any) -> None:
    builder.store(value, pointer, align=4)


def _numbers(context: Any, builder: Any, kind: Any, array: Any, index: Any, count: int) -> list[Any]:
    """So many numbers of an array, from an index on."""
    data = context.make_array(kind)(context, builder, array).data
    places = [builder.add(index, ir.Constant(index.type, i)) for i in range(count)]
    return [builder.load(builder.gep(data, [place])) for place in places]


def _rows(context: Any, builder: Any, signature: Any, args: Any, count: int) -> list[Any]:
    """Pointers to rows ``args[1]``, and so many more that are ``args[2]`` apart."""
    row, found = args[1], []
    for _ in range(count):
        index = builder.mul(row, ir.Constant(row.type, COUNT))
        found.append(_pointer(context, builder, signature.args[0], args[0], index))
        row = builder.add(row, args[2])
    return found


def _chosen(context: Any, builder: Any, signature: Any, args: Any) -> tuple[list[Any], list[Any]]:
    """Pointers to the first and to the second rows of `gather_sum`."""
    array, base, at = args[0], args[1], args[4]

    def pointers(kind: Any, rows: Any) -> list[Any]:
        found = []
        for row in _numbers(context, builder, kind, rows, at, COUNT):
            index = builder.mul(builder.add(base, row), ir.Constant(base.type, COUNT))
            found.append(_pointer(context, builder, signature.args[0], array, index))
        return found

    return pointers(signature.args[2], args[2]), pointers(signature.args[3], args[3])


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """COUNT values as the columns of what they are the rows of: blocks of 1, 2, 4 and 8 change places."""
    block = 1
    while block < COUNT:
        low = [i if not i & block else COUNT + i - block for i in range(COUNT)]
        high = [i + block if not i & block else COUNT + i for i in range(COUNT)]
        masks = [ir.Constant(ir.VectorType(_INDEX, COUNT), mask) for mask in (low, high)]
        rows = [
            builder.shuffle_vector(rows[i & ~block], rows[i | block], masks[1 if i & block else 0])
            for i in range(COUNT)
        ]
        block *= 2
    return rows


def _splat(builder: Any, number: Any) -> Any:
    none = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(none, number, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(first, none, ir.Constant(ir.VectorType(_INDEX, COUNT), [0] * COUNT))


def _signed(name: str) -> Any:
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FUSED)


def _chosen_by(order: str) -> Any:
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(order, a, b), a, b)


def _of_two(make: Any) -> Any:
    @_intrinsic
    def found(_typing: Any, _a: Any, _b: Any) -> Maker:
        return LANES(LANES, LANES), lambda _context, builder, _signature, args: make(builder, *args)

    return found


least, most = _of_two(_chosen_by("<")), _of_two(_chosen_by(">"))
"""The smaller and the larger of two values, place by place; the second where one is no number."""


def _means(sign: Any, name: str) -> None:
    """Define an operator between two values, or a number and a value."""
    made = _of_two(_signed(name))

    @overload(sign, strict=False)
    def _of_them(a: Any, b: Any) -> Any:
        if isinstance(a, Lanes) and isinstance(b, Lanes):
            return lambda a, b: made(a, b)
        if isinstance(a, types.Float) and isinstance(b, Lanes):
            return lambda a, b: made(splat(a), b)
        return None


_means(operator.add, "fadd")
_means(operator.sub, "fsub")
_means(operator.mul, "fmul")
_means(operator.truediv, "fdiv")
