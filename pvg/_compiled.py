"""The one decorator of the compiled functions: numba without the interpreter's lock, and its cache of machine code.

numba's own cache refuses to work where it may not write, fails where a disk is full, and forgets that a function holds
the code of those it calls in other files. This one reads what was compiled before wherever it lies, also where it may
only read, writes where it can, and otherwise compiles for this process alone (docs/decisions/0013).
"""

from __future__ import annotations

import glob
import hashlib
import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, wraps
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import CompileResult

from pvg._folders import cache_root

Function = TypeVar("Function", bound=Callable[..., Any])

_log = logging.getLogger("pvg")


def kernel(*, fastmath: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Compile a function for the types of its first call and keep the machine code for the next process.

    fastmath: the numbers are finite and sums may be reordered, which lets sums and maxima use vector registers;
    inline: merge the function into the kernels that call it. The decorated function keeps its declared types.
    """
    # a division that might raise keeps its loop from vectorising; numpy's gives infinity
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    if fastmath:
        options["fastmath"] = True
    if inline:
        options["inline"] = "always"  # its code lies in its callers' cache

    def compiled(function: Function) -> Function:
        dispatcher = numba.njit(**options)(function)
        if not inline and dispatcher is not function:  # NUMBA_DISABLE_JIT gives the function itself
            dispatcher._cache = _KernelCache(function)
            dispatcher.compile = _undisturbed(dispatcher.compile)
        return cast("Function", dispatcher)

    return compiled


def _undisturbed(function: Function) -> Function:
    """The function; signals that come while it works are handled after it."""

    @wraps(function)
    def held(*given: Any) -> Any:
        with _signals_held():
            return function(*given)

    return cast("Function", held)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Inside the block handlers of signals wait for its end.

    LLVM calls back into Python, where what a handler raises, as that of Ctrl-C does, would be lost, or crash it. Python
    runs handlers in the main thread alone, so others have nothing to hold.
    """
    handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
    came: list[int] = []
    holding, here = True, threading.get_ident()

    def take(number: int, frame: FrameType | None) -> None:
        if holding and threading.get_ident() == here:
            came.append(number)
        else:  # one handler raised something before the others were put back, or another thread forked this process
            handlers[number](number, frame)

    try:
        if threading.current_thread() is threading.main_thread():
            for number in signal.valid_signals():
                handler = signal.getsignal(number)
                if callable(handler):
                    handlers[number] = handler
                    signal.signal(number, take)
        yield
    finally:
        holding = False
        for held, handler in handlers.items():
            signal.signal(held, handler)
        with ExitStack() as all_of_them:  # though one of them raises something
            for taken in reversed(came):
                # not raised anew: a loop of asyncio has been told of it already
                all_of_them.callback(handlers[taken], taken, None)


class _KernelCache:
    """Machine code of one function, in the first place that has it; what numba's dispatchers call a cache.

    A file written by somebody else is as trusted as the module beside it: no place is shared between users. Each set of
    types has an index of its own: in one of all, two processes that compile at the same time would both call theirs the
    first, and the index of one would name the code of the other.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = cast(FunctionType, function)
        code = self._function.__code__
        file = Path(code.co_filename)
        name = f"{file.stem}.{function.__qualname__}-{code.co_firstlineno}.{sys.implementation.cache_tag}{sys.abiflags}"
        self._name = name.replace("<", "").replace(">", "")
        self._stamp = _stamp(self._function)
        self._places = _places(file.parent) if self._stamp else []

    @property
    def cache_path(self) -> str | None:
        """Folder that is looked into first."""
        return str(self._places[0]) if self._places else None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled function for these types, or None. A damaged file counts as none."""
        context.refresh()
        key = self._key(signature, context.codegen())
        for file in self._files(key):
            try:
                found = file.load(key)
            except Exception as error:  # unpickling a damaged file may raise anything
                _log.debug("the kernel cache %s cannot be read: %r", file._index_path, error)
                continue
            if found is not None:
                return CompileResult._rebuild(context, *found)  # type: ignore[no-untyped-call]
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled in the first place that can be written."""
        key = self._key(signature, compiled.codegen)
        data = compiled._reduce()
        for file in self._files(key):
            try:
                Path(file._cache_path).mkdir(parents=True, exist_ok=True)
                _save(file, key, data)
            except OSError:
                continue
            return
        _say_uncached()

    def flush(self) -> None:
        """Forget what was kept, where it can be written."""
        for place in self._places:
            with suppress(OSError):
                for index in place.glob(f"{glob.escape(self._name)}.*.nbi"):
                    index.unlink()

    def _files(self, key: tuple[Any, ...]) -> list[Any]:
        """The files of one set of types on one processor, by preference."""
        signature, processor, _ = key
        types = hashlib.sha256(repr((str(signature), processor)).encode()).hexdigest()[:16]
        name = f"{self._name}.{types}"
        return [IndexDataCacheFile(str(place), name, self._stamp) for place in self._places]  # type: ignore[no-untyped-call]

    def _key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        # the processor is part of it: its name and features, or what NUMBA_CPU_NAME and NUMBA_CPU_FEATURES say instead
        return (signature, codegen.magic_tuple(), hashlib.sha256(self._function.__code__.co_code).hexdigest())


def _save(file: Any, key: tuple[Any, ...], data: Any) -> None:
    try:
        file.save(key, data)
    except OSError:
        raise
    except Exception:  # a damaged index, which is read before it is extended
        file.flush()
        file.save(key, data)


def _places(folder: Path) -> list[Path]:
    """Folders for the machine code of the modules in `folder`, by preference; the first may be one to read only.

    Beside the modules first, where an image or the installation has it, then in the user's own cache folder. Where
    NUMBA_CACHE_DIR is set that is the only place.
    """
    below = f"{folder.name}_{hashlib.sha256(str(folder).encode()).hexdigest()[:16]}"
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        return [Path(numba.config.CACHE_DIR) / below]  # type: ignore[attr-defined]
    root = cache_root()
    return [folder / "__pycache__", *([root / "kernels" / below] if root else [])]


def _stamp(function: FunctionType) -> str:
    """A digest of all that the machine code is made of: the function's file, those of the functions it calls, the
    numbers it takes from its module, and this file, which has the compiler's options. Empty without a source file.
    """
    files, numbers = {__file__}, []
    waiting, seen = [function], {function}
    while waiting:
        one = waiting.pop()
        files.add(one.__code__.co_filename)
        for name in one.__code__.co_names:
            value = one.__globals__.get(name)
            called = getattr(getattr(value, "_dispatcher", value), "py_func", None)
            if isinstance(called, FunctionType):
                if called not in seen:
                    seen.add(called)
                    waiting.append(called)
            elif isinstance(value, np.ndarray):
                numbers.append((name, value.tobytes()))
            elif isinstance(value, (int, float, tuple, np.generic)):
                numbers.append((name, repr(value).encode()))
    try:
        digests = sorted(_file_digest(file) for file in files)
    except OSError:
        return ""
    return hashlib.sha256(repr((digests, sorted(numbers))).encode()).hexdigest()


@cache
def _file_digest(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@cache
def _say_uncached() -> None:
    _log.warning(
        "pvg compiles its kernels in every process anew, which takes half a minute: nothing can be written beside its "
        "modules nor in the user's cache folder; set PVG_CACHE_DIR to a folder of your own"
    )
