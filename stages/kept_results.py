"""Results of long calls, kept by the content of their arguments.

A stage is a pure function, and so is each of its long calls. While a store is in use, a
call that was made before with the same arguments returns what it returned then: a stage
that was killed goes on with the call that was in flight. Without a store nothing is
kept, and nothing else changes; `use_any_store` keeps results in memory then.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from typing import Any, ParamSpec, Protocol, TypeVar

import numpy as np

ArgumentsP = ParamSpec("ArgumentsP")
Arrays = tuple[np.ndarray, ...]
ResultT = TypeVar("ResultT", np.ndarray, Arrays)
DIGEST_ATTRIBUTE = "_content_digest"  # of a frozen dataclass, once it is known


class ResultStore(Protocol):
    """Keep results beyond the process that computed them."""

    def find(self, key: str) -> Arrays | None:
        """Return the result that was kept under a key, if there is one."""

    def keep(self, key: str, result: Arrays) -> None:
        """Keep a result under a key, for whoever asks for that key later."""


_store: ContextVar[ResultStore | None] = ContextVar("store of results", default=None)


@contextmanager
def use_store(store: ResultStore) -> Iterator[None]:
    """Keep the results of long calls in a store for the duration of the context."""
    token = _store.set(store)
    try:
        yield
    finally:
        _store.reset(token)


@contextmanager
def use_any_store() -> Iterator[None]:
    """Keep the results of long calls in memory, unless a store is in use."""
    if _store.get() is not None:
        yield
        return
    with use_store(MemoryStore()):
        yield


class MemoryStore:
    """Keep results in memory."""

    def __init__(self) -> None:
        self._results: dict[str, Arrays] = {}

    def find(self, key: str) -> Arrays | None:
        """Return the result that was kept under a key, if there is one."""
        return self._results.get(key)

    def keep(self, key: str, result: Arrays) -> None:
        """Keep a result under a key, for whoever asks for that key later."""
        self._results[key] = result


def keep_results(
    function: Callable[ArgumentsP, ResultT],
) -> Callable[ArgumentsP, ResultT]:
    """Keep the results of a pure function while a store is in use.

    The function returns one array of real numbers, or a tuple of none or several.
    """

    @functools.wraps(function)
    def find_or_call(
        *arguments: ArgumentsP.args, **named: ArgumentsP.kwargs
    ) -> ResultT:
        store = _store.get()
        if store is None:
            return function(*arguments, **named)
        key = content_digest([function, arguments, named])
        stored = store.find(key)
        if stored is not None:
            found: Any = stored[0] if len(stored) == 1 else stored
            return found
        result = function(*arguments, **named)
        store.keep(key, result if isinstance(result, tuple) else (result,))
        return result

    return find_or_call


def content_digest(value: Any) -> str:
    """Hash a value by its content: dataclasses, arrays and plain values, nested."""
    digest = hashlib.blake2b(digest_size=32)
    for part in _content_parts(value):
        digest.update(part)
    return digest.hexdigest()


def _content_parts(value: Any) -> Iterator[bytes]:
    """Yield bytes by which the content of a value differs from that of any other."""
    yield f"{type(value).__module__}.{type(value).__qualname__}(".encode()
    if is_dataclass(value) and not isinstance(value, type):
        yield _dataclass_digest(value).encode()
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, Mapping):
        # in any order: stored settings are sorted, those of a command are not
        for digest in sorted(map(content_digest, value.items())):
            yield digest.encode()
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for inner in value:
            yield from _content_parts(inner)
    elif isinstance(value, type) or callable(value):
        yield f"{value.__module__}.{value.__qualname__}".encode()
    elif value is None or isinstance(value, str | bytes | int | float | np.generic):
        yield repr(value).encode()
    else:
        raise TypeError(f"{type(value).__qualname__} has no content that can be hashed")
    yield b")"


def _dataclass_digest(value: Any) -> str:
    """Hash a dataclass by its fields, once if it cannot change."""
    known = vars(value).get(DIGEST_ATTRIBUTE)
    if known is None:
        content = {field.name: getattr(value, field.name) for field in fields(value)}
        known = content_digest(content)
        if type(value).__dataclass_params__.frozen:
            vars(value)[DIGEST_ATTRIBUTE] = known
    return str(known)
