# SPDX-License-Identifier: Apache-2.0
"""Fast calls of CasADi functions: fixed buffers, and C where a compiler is there."""

import _ctypes
import ctypes
import fcntl
import hashlib
import os
import platform
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

# contraction into fused multiply-add would make results differ between processors; the others change none:
# a source's own functions are put in place, and nobody asks for `errno` or for what the arithmetic signals
COMPILER_FLAGS = (
    "-O2", "-ffp-contract=off", "-fPIC", "-shared",
    "-fno-semantic-interposition", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
# shorter code of the same operations
NEWER_INSTRUCTIONS = "avx2"
PATIENCE_S, LOOK_S = 60.0, 0.02  # with another process that builds the same library
COMPILER_S = 300.0  # at most; seconds are enough on a machine that is not busy
# calls of the mathematics library; as these do, the comparison takes the number if the other is NaN
IN_PLACE = {
    "return fmax(x, y);": "return x > y || y != y ? x : y;",
    "return fmin(x, y);": "return x < y || y != y ? x : y;",
}


class Compiled:
    """A CasADi function that is called with numbers, without a conversion or an allocation a call.

    Attributes:
        inputs, outputs: flat arrays that `evaluate` reads and overwrites; a call fills the former.
        evaluate: for who keeps the numbers in `inputs`.
    """

    def __init__(self, function: ca.Function):
        self.function = function
        self._buffer, self.evaluate = function.buffer()
        inputs = [np.zeros(function.sparsity_in(i).shape, order="F") for i in range(function.n_in())]
        outputs = [np.zeros(function.sparsity_out(i).shape, order="F") for i in range(function.n_out())]
        for i, array in enumerate(inputs):
            self._buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # the stub asks for its size
        for i, array in enumerate(outputs):
            self._buffer.set_res(i, array.data)  # type: ignore[call-arg]
        self.inputs = [array.reshape(-1, order="F") for array in inputs]
        self.outputs = [array.reshape(-1, order="F") for array in outputs]

    def __call__(self, *arguments: npt.ArrayLike) -> list[npt.NDArray[np.float64]]:
        """Evaluate; returns flat arrays that the next call overwrites."""
        for target, argument in zip(self.inputs, arguments, strict=True):
            target[:] = argument
        self.evaluate()
        return self.outputs


def pointer(array: npt.NDArray[Any]) -> ctypes.c_void_p:
    """Return where an array begins, for machine code."""
    return ctypes.c_void_p(array.ctypes.data)


def taken_out(expression: ca.SX, symbols: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the expression with what depends on `symbols` alone taken out, its names, its values."""
    inner, names, values = ca.extract_parametric(expression, symbols)
    return ca.densify(inner), ca.vertcat(*names), ca.densify(ca.vertcat(*values))


class Distrusted(Exception):
    """A cache of machine code that others can write to, or that cannot run: the message says why."""


def compiled(function: ca.Function) -> Compiled:
    """Return the function as machine code if gcc or cc is there, else on CasADi's virtual machine."""
    library = _library(function)
    return Compiled(function if library is None else ca.external(function.name(), str(library)))


def loads(library: Path) -> bool:
    """Return whether a cached library can be loaded; one that was cut short is removed, to be built anew."""
    try:
        _ctypes.dlclose(ctypes.CDLL(str(library))._handle)  # kept open, it hides what becomes of it
    except OSError:
        library.unlink(missing_ok=True)
        return False
    return True


def _library(function: ca.Function) -> Path | None:
    newer = [(f"-m{NEWER_INSTRUCTIONS}",)] if NEWER_INSTRUCTIONS in processor().split() else []
    return best_library(function.name(), _dense_source(function), COMPILER_FLAGS, [*newer, ()])


def shared_library(name: str, source: str, flags: tuple[str, ...]) -> Path | None:
    """Return a library compiled from C source, cached by its content; None where that is not possible.

    Raises:
        Distrusted: others can write to the cache, or nothing can be loaded from it.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or os.environ.get("PAM_ORTHOSIS_NO_COMPILER"):
        return None
    digest = hashlib.sha256(" ".join((source, compiler, *flags)).encode()).hexdigest()[:20]
    folder = _cache_folder()
    if folder is None:
        return None
    library = folder / f"{name}_{digest}.so"
    try:
        _check_owned(folder)
        if _is_there(library):
            return library
        with _alone(library):
            if _is_there(library):  # another process has built it meanwhile
                return library
            built = _compile([compiler, *flags], source, library)
        if built and not loads(library):
            raise Distrusted(f"{folder} lets no program run from it")
    except OSError:  # the disk is full
        return None
    return library if built else None


def _is_there(library: Path) -> bool:
    """Return whether there is a library that can be loaded; Distrusted if others can write to it."""
    if not os.path.lexists(library):
        return False
    _check_owned(library)
    return loads(library)


@contextmanager
def _alone(library: Path) -> Iterator[None]:
    """Wait, but not for ever, until no other process builds a library."""
    path, deadline = library.with_suffix(".lock"), time.monotonic() + PATIENCE_S
    file, is_own = _opened(path)
    try:
        with suppress(OSError):  # a disk that knows no locks: both build it
            while not _locked(file) and time.monotonic() < deadline:
                time.sleep(LOOK_S)
        yield
    finally:
        if is_own and path.exists() and os.path.samestat(os.fstat(file), path.lstat()):
            path.unlink(missing_ok=True)
        os.close(file)


def _opened(path: Path) -> tuple[int, bool]:
    """Return the file by which processes agree, open, and whether this call has created it."""
    while True:
        with suppress(FileExistsError):
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600), True
        with suppress(FileNotFoundError):  # who created it has just removed it
            return os.open(path, os.O_RDWR | os.O_NOFOLLOW), False


def _locked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _check_owned(path: Path) -> None:
    """Check that nobody else can have put machine code there; Distrusted if somebody can."""
    state = path.stat() if path.is_dir() else path.lstat()
    if state.st_uid != os.geteuid():
        raise Distrusted(f"machine code in {path} is of another user (uid {state.st_uid}) and is not loaded")
    if state.st_mode & (stat.S_IWGRP | stat.S_IWOTH) or stat.S_ISLNK(state.st_mode):
        raise Distrusted(f"machine code in {path} can be written by others and is not loaded (chmod go-w)")
    if os.statvfs(path).f_flag & os.ST_NOEXEC:
        raise Distrusted(f"{path} is on a disk that lets no program run from it (noexec)")


@lru_cache
def _tell_once(line: str) -> None:
    print(f"caution: {line}", file=sys.stderr)


def best_library(
    name: str, source: str, flags: tuple[str, ...], options: Iterable[tuple[str, ...]]
) -> Path | None:
    """Return the library built with the first of some options that the compiler takes, beside the flags."""
    try:
        libraries = (shared_library(name, source, (*flags, *more)) for more in options)
        return next(filter(None, libraries), None)
    except Distrusted as error:
        _tell_once(f"{error}: CasADi computes without it, slower; XDG_CACHE_HOME gives another folder")
        return None


def remembered(name: str, key: str) -> Path | None:
    """Return the library that was built for a key, see `remember`; None if there is none to trust."""
    folder = _cache_folder()
    if folder is None or os.environ.get("PAM_ORTHOSIS_NO_COMPILER"):
        return None
    note = _note(folder, name, key)
    try:
        _check_owned(folder)
        _check_owned(note)
        library = folder / note.read_text(encoding="utf-8")
        if not re.fullmatch(rf"{name}_[0-9a-f]{{20}}\.so", library.name) or library.parent != folder:
            return None  # no library of ours: one that does not load would be removed
        _check_owned(library)
        return library if loads(library) else None
    except (OSError, ValueError, Distrusted):
        return None


def remember(name: str, key: str, library: Path) -> None:
    """Note which library was built for a key, all that its source follows from; what is there stays."""
    with suppress(OSError), tempfile.TemporaryDirectory(dir=library.parent) as folder:
        written = Path(folder, "note")
        written.write_text(library.name, encoding="utf-8")
        written.chmod(0o600)
        os.link(written, _note(library.parent, name, key))  # fails where there is something


def _note(folder: Path, name: str, key: str) -> Path:
    return folder / f"{name}_{hashlib.sha256(key.encode()).hexdigest()[:20]}.txt"


def processor() -> str:
    """Return what distinguishes processors, lest a library built on another one is taken from the cache."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())


def _dense_source(function: ca.Function) -> str:
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    for call, comparison in IN_PLACE.items():
        source = source.replace(call, comparison)
    return source


def _cache_folder() -> Path | None:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(base) / "pam_orthosis"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def _compile(command: list[str], source: str, library: Path) -> bool:
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        code, built = Path(folder, "f.c"), Path(folder, "f.so")
        code.write_text(source, encoding="utf-8")
        whole = [*command, str(code), "-o", str(built), "-lm"]
        silent: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        try:
            if subprocess.run(whole, check=False, timeout=COMPILER_S, **silent).returncode != 0:
                return False
        except subprocess.TimeoutExpired:
            os.environ["PAM_ORTHOSIS_NO_COMPILER"] = "1"  # or each function would wait as long
            _tell_once(
                f"{command[0]} does not end; it was stopped after {COMPILER_S:g} s: computing goes on without"
            )
            return False
        built.chmod(0o700)  # whatever the mask is: what others can write is not loaded
        os.replace(built, library)  # several processes may build the same library at once
    return True
