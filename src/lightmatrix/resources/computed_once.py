"""A property that is computed once, whatever threads ask for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from threading import RLock
from typing import Any, Self, TypeVar, overload

T = TypeVar("T")


class computed_once(cached_property[T]):  # noqa: N801 - a decorator, written like the one it extends
    """A `cached_property` that one thread computes while others wait for it.

    From Python 3.12 on, threads that ask a `cached_property` at the same time all compute it. One
    lock serves all instances, so the function must not wait for threads that ask for the same.
    """

    def __init__(self, function: Callable[[Any], T]) -> None:
        super().__init__(function)
        self._computing = RLock()

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: object, owner: type[Any] | None = None) -> Any:
        """The value, or the property itself if a class is asked."""
        with self._computing:
            return super().__get__(instance, owner)
