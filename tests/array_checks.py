"""The checks of types and array shapes on every call, at a fraction of their usual cost.

`--jaxtyping-packages` decorates every function of `rpl_data` with `jaxtyping.jaxtyped`, which binds the
arguments by their names and checks them twice per call. `quick_checks` puts a decorator in its place that
checks the same arguments and the same result, once each, and in one context for the names of the axes.
"""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import beartype

_jaxtyped = jaxtyping.jaxtyped


def quick_checks() -> None:
    """Check functions that are imported from now on; classes and generators are left to jaxtyping."""
    jaxtyping.jaxtyped = checked


def checked(function: Any = None, *, typechecker: Any) -> Any:
    """Stand in for `jaxtyping.jaxtyped`."""
    if function is None:
        return functools.partial(checked, typechecker=typechecker)
    yields = inspect.isgeneratorfunction(function) or inspect.iscoroutinefunction(function)
    if not inspect.isfunction(function) or yields or inspect.isasyncgenfunction(function):
        return _jaxtyped(function, typechecker=typechecker)
    hints = {name: _hint(value, function) for name, value in function.__annotations__.items()}
    inner = beartype(_with_hints(function, hints))
    if not any(map(_has_array, hints.values())):
        return functools.wraps(function)(inner)

    @functools.wraps(function)
    def in_context(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        with _jaxtyped("context"):
            return inner(*arguments, **named)

    return in_context


def _hint(value: Any, function: Callable[..., Any]) -> Any:
    """What an annotation means; anything, where its names are known to type checkers only."""
    holder = types.SimpleNamespace(__annotations__={"value": value})
    try:
        return typing.get_type_hints(holder, function.__globals__, include_extras=True)["value"]
    except Exception:  # as jaxtyping does
        return Any


def _with_hints(function: types.FunctionType, hints: dict[str, Any]) -> types.FunctionType:
    """The function with other annotations; the original keeps its own."""
    copy = types.FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__, copy.__annotations__ = function.__kwdefaults__, hints
    copy.__module__, copy.__qualname__, copy.__doc__ = function.__module__, function.__qualname__, None
    return copy


def _has_array(hint: Any) -> bool:
    if isinstance(hint, list | tuple):  # the arguments of a Callable
        return any(map(_has_array, hint))
    is_array = inspect.isclass(hint) and issubclass(hint, jaxtyping.AbstractArray)
    return is_array or any(map(_has_array, typing.get_args(hint)))
