"""Array code, written out as straight code in plain floats.

numpy costs the same 0.3 to 3 us for four numbers as for a thousand, and a step of the law calls it a hundred
times and more. For one vehicle the arithmetic is therefore run once with arrays of symbols: what it does to
them is noted, operation by operation, and becomes the source of a Python function without arrays, calls or
loops. There is one implementation, and the function does exactly what the array code does, in the same order.

What may be traced: arithmetic, comparisons, minimum, maximum, abs, sqrt, copysign, rint, where, stack, and
look-ups in constant tables. Anything else raises TypeError while tracing, and so does a branch on a symbol.
A product with a constant 0 is 0, a constant 1 or an added 0 leaves out the operation; otherwise results are
those of numpy to the last bit, NaN included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from kffa_offboard.control import Array

_DEEPEST = 12  # of nested parentheses

#: How each operation is written; the arguments' text goes in.
_TEMPLATES = {
    "add": "({0} + {1})",
    "subtract": "({0} - {1})",
    "multiply": "({0} * {1})",
    "divide": "({0} / {1})",
    "negative": "(-{0})",
    "absolute": "abs({0})",
    "sqrt": "sqrt({0})",
    "sin": "sin({0})",
    "cos": "cos({0})",
    "square": "({0} * {0})",
    "copysign": "copysign({0}, {1})",
    # Adding and taking away 1.5 * 2^52 rounds to the nearest whole number, halves to even, as numpy does.
    "rint": "({0} + 6755399441055744.0 - 6755399441055744.0)",
    "minimum": "({0} if {0} < {1} else {1} if {1} <= {0} else nan)",
    "maximum": "({0} if {0} > {1} else {1} if {1} >= {0} else nan)",
    "less": "({0} < {1})",
    "less_equal": "({0} <= {1})",
    "greater": "({0} > {1})",
    "greater_equal": "({0} >= {1})",
    "not_equal": "({0} != {1})",
    "where": "({1} if {0} else {2})",
    "int": "int({0})",
    "row": "{0}[int({1})]",
    "entry": "{0}[{1}]",
}
_TWICE = frozenset({"square", "minimum", "maximum"})  # write an argument more than once: it must have a name
_NAMESPACE = {
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "copysign": math.copysign,
    "nan": math.nan,
    "inf": math.inf,
}


class Symbol:
    """A number that is known only when the function runs."""

    __slots__ = ("arguments", "operation", "tape")

    def __init__(self, tape: Tape, operation: str, arguments: tuple[Any, ...]) -> None:
        self.tape = tape
        self.operation = operation
        self.arguments = arguments

    def __bool__(self) -> bool:
        raise TypeError(
            "a branch depends on a number that is known only when the function runs; use np.where"
        )

    def __float__(self) -> float:
        raise TypeError("this number is known only when the function runs")


class Tape:
    """Symbols of one function, each expression once."""

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], Symbol] = {}
        self.tables: list[tuple[tuple[float, ...], ...]] = []

    def inputs(self, name: str, shape: tuple[int, ...]) -> Traced:
        """An array of symbols; the function takes its entries as one flat sequence called `name`."""
        count = math.prod(shape)
        return traced([Symbol(self, "input", (f"{name}{k}",)) for k in range(count)], shape)

    def note(self, operation: str, *arguments: Any) -> Any:
        """The result of an operation on symbols and numbers."""
        short = _simplified(operation, arguments)
        if short is not None:
            return short
        key = (operation, *((type(value), value) for value in arguments))
        if key not in self._known:
            self._known[key] = Symbol(self, operation, arguments)
        return self._known[key]

    def forget(self) -> None:
        """Let go of the symbols, which know their tape."""
        self._known.clear()

    def table(self, values: Array) -> Symbol:
        """A constant table ``(rows, n)`` whose rows are looked up by number."""
        self.tables.append(tuple(map(tuple, values.tolist())))
        return Symbol(self, "input", (f"table{len(self.tables) - 1}",))


def _simplified(operation: str, arguments: tuple[Any, ...]) -> Any:
    """What needs no operation, or None."""
    first, second = arguments[0], arguments[-1]
    if operation == "multiply" and 0.0 in (_number(first), _number(second)):
        return 0.0
    if operation == "multiply" and _number(first) == 1.0:
        return second
    if operation in ("multiply", "divide") and _number(second) == 1.0:
        return first
    if operation in ("add", "subtract") and _number(second) == 0.0:
        return first
    if operation == "add" and _number(first) == 0.0:
        return second
    if operation == "where" and not isinstance(first, Symbol):
        return arguments[1] if first else second
    return None


def _number(value: Any) -> float | None:
    return None if isinstance(value, Symbol) else float(value)


class Traced(np.ndarray[Any, Any]):
    """An array of symbols and numbers."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **others: Any) -> Any:
        """Note the operation for each entry."""
        operation = ufunc.__name__
        if method != "__call__" or others or operation not in _TEMPLATES:
            raise TypeError(f"{operation} ({method}) cannot be written out for one vehicle")
        constants = [value for value in inputs if not isinstance(value, Traced)]
        if len(constants) == len(inputs):
            return getattr(ufunc, method)(*inputs)
        return _each(operation, ufunc, inputs)

    def __array_function__(self, function: Any, types: Any, arguments: Any, keywords: Any) -> Any:
        """Note what numpy functions do."""
        if function is np.where:
            return _each("where", np.where, arguments)
        if function is np.stack and not keywords:
            return traced(np.stack([np.asarray(part, dtype=object) for part in arguments[0]]))
        if function is np.zeros_like:
            return np.zeros(arguments[0].shape)
        raise TypeError(f"{function.__name__} cannot be written out for one vehicle")

    def __getitem__(self, place: Any) -> Any:
        """Entries are arrays without axes, so that numpy's functions know them."""
        return _array(super().__getitem__(place))

    def __iter__(self) -> Iterator[Any]:
        """Its rows, or entries."""
        return (self[k] for k in range(len(self)))

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """Whole numbers, towards zero."""
        if dtype is not np.intp:
            raise TypeError(f"a conversion to {dtype} cannot be written out for one vehicle")
        return _each("int", np.trunc, (self,))


def traced(values: Any, shape: tuple[int, ...] | None = None) -> Traced:
    """An array of symbols and numbers, of `shape` if given."""
    array = np.empty(len(values), dtype=object) if isinstance(values, list) else values
    if isinstance(values, list):
        array[:] = values
    return (array if shape is None else array.reshape(shape)).view(Traced)


def _entries(value: Any) -> Any:
    """A plain array of symbols and Python numbers."""
    if isinstance(value, Traced):
        return value.view(np.ndarray)
    return np.asarray(value).astype(object)


def _each(operation: str, constant: Callable[..., Any], inputs: Sequence[Any]) -> Any:
    """Do an operation entry by entry, with numbers alone as numpy does."""

    def one(*values: Any) -> Any:
        tape = next((value.tape for value in values if isinstance(value, Symbol)), None)
        if tape is None:
            return constant(*values).item()
        return tape.note(operation, *values)

    result = np.frompyfunc(one, len(inputs), 1)(*map(_entries, inputs))
    return _array(result)


def _array(value: Any) -> Traced:
    """What numpy has made of symbols, as an array in any case."""
    if isinstance(value, Traced):
        return value
    whole = np.empty(np.shape(value), dtype=object)
    whole[...] = value
    return whole.view(Traced)


def take_columns(table: Array, index: Any) -> Any:
    """``table.take(index, axis=1)``, where `index` may be an array of symbols."""
    if not isinstance(index, Traced):
        return table.take(index, axis=1)
    columns = []
    for place in _entries(index):
        rows = place.tape.table(table.T)
        row = place.tape.note("row", rows, place)
        columns.append([place.tape.note("entry", row, k) for k in range(len(table))])
    return traced(np.array(columns, dtype=object).T)


class _Writer:
    """Turns symbols into lines of source."""

    def __init__(self, results: Sequence[Any]) -> None:
        self.lines: list[str] = []
        self._uses: dict[int, int] = {}
        self._text: dict[int, tuple[str, int]] = {}
        for result in results:
            self._count(result)
        self.results = [self._write(result)[0] for result in results]

    def _count(self, value: Any) -> None:
        if not isinstance(value, Symbol):
            return
        self._uses[id(value)] = self._uses.get(id(value), 0) + 1
        if self._uses[id(value)] == 1 and value.operation != "input":
            for argument in value.arguments:
                self._count(argument)
                if value.operation in _TWICE:
                    self._count(argument)

    def _write(self, value: Any) -> tuple[str, int]:
        """Text of a value, and how deeply it is nested."""
        if not isinstance(value, Symbol):
            return repr(value), 0
        if value.operation == "input":
            return str(value.arguments[0]), 0
        known = self._text.get(id(value))
        if known is not None:
            return known
        parts = [self._write(argument) for argument in value.arguments]
        text = _TEMPLATES[value.operation].format(*(part for part, _ in parts))
        depth = 1 + max(depth for _, depth in parts)
        if self._uses[id(value)] > 1 or depth > _DEEPEST:
            name = f"v{len(self.lines)}"
            self.lines.append(f"{name} = {text}")
            text, depth = name, 0
        self._text[id(value)] = text, depth
        return text, depth


def compiled(
    tape: Tape, inputs: dict[str, Traced], results: Iterable[Any]
) -> Callable[..., tuple[float, ...]]:
    """The function of `inputs`, each one flat sequence; it returns the entries of `results` in one tuple.

    Its docstring is its source.
    """
    flat = [entry for result in results for entry in _entries(result).reshape(-1)]
    writer = _Writer(flat)
    body = [
        f"({', '.join(entry.arguments[0] for entry in _entries(array).reshape(-1))},) = {name}"
        for name, array in inputs.items()
        if array.size
    ]
    body += [*writer.lines, f"return ({', '.join(writer.results)},)"]
    source = "\n    ".join([f"def function({', '.join(inputs)}):", *body])
    namespace: dict[str, Any] = {
        **_NAMESPACE,
        **{f"table{k}": rows for k, rows in enumerate(tape.tables)},
    }
    exec(compile(source, "<traced>", "exec"), namespace)
    function: Callable[..., tuple[float, ...]] = namespace["function"]
    function.__doc__ = source
    tape.forget()
    return function
