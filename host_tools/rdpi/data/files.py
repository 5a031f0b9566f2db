"""Files: read whole, replaced in one step, and brought to disk."""

from __future__ import annotations

import errno
import io
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import BadInput

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None

_CANNOT_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF, errno.EACCES, errno.EPERM)


def content(path: str) -> bytes:
    """Of a file, or of a pipe that is being written to. Raises BadInput for what may have no end, and OSError."""
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
            raise BadInput(f"{path}: is a device; give a file")
        if not stat.S_ISFIFO(mode):
            return Path(path).read_bytes()
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # else opening waits for a writer, for ever if none comes
        os.set_blocking(handle, True)
        with open(handle, "rb") as pipe:
            data = pipe.read()
        if not data:
            raise BadInput(f"{path}: this pipe is empty; start the program that writes to it first")
        return data
    except MemoryError:
        raise BadInput(f"{path}: there is not enough memory for this file; give a shorter one") from None


def read_bytes(path: str) -> bytes:
    """Content of a file. Raises BadInput when it cannot be read."""
    try:
        return content(path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); check the file name and permissions") from None


def atomic_write(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Replace a file's content in one step: readers see the old file or the new one, never a part of either.

    So do those who read after a power failure; of what this has returned from, the new one, as far as the file system
    keeps its word. Text is written as UTF-8 with "\\n". A link is followed; a device or pipe is simply written to.
    Raises OSError, which names `path`.
    """
    try:
        _replace(Path(path), data.encode() if isinstance(data, str) else data)
    except OSError as error:
        error.filename = os.fspath(path)  # the user knows the target, not the temporary file
        raise


def write_all(file: io.RawIOBase, data: bytes) -> None:
    """Write, and return when it is on disk; to a device or pipe, when it is written."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest):]
    _sync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Bring a folder's names to disk, those of its files too: a file that is on disk without its name is lost."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # may be written to, but not read; on Windows no folder can be opened
        return
    try:
        _sync(handle)
    finally:
        os.close(handle)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder and those above it, where they are not there. A power failure does not undo it."""
    folder = Path(path)
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        sync_folder(folder.parent)


@contextmanager
def reserved(path: str | None) -> Iterator[None]:
    """Keep other programs from this file, which need not be there. Raises BadInput if one is at work on it.

    A lock does that, which ends with its process, however that ends: the lock's file may then stay behind, and hinders
    nobody. Without a path, to a device, and where files cannot be locked, this does nothing.
    """
    if path is None or fcntl is None or os.path.exists(path) and not os.path.isfile(path):
        yield
        return
    target = Path(os.path.realpath(path))
    lock = target.with_name(f".rdpi.{target.name}.lock")
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise BadInput(f"{path}: another rdpi is writing to this file; stop it first, or give another name") from None
        except OSError:  # some network file systems
            break
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), os.stat(lock)):
                break
        os.close(handle)  # of one that ended just now and has taken its file away
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
            sync_folder(lock.parent)
        os.close(handle)


def _replace(path: Path, data: bytes) -> None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        mode = None
    if mode is not None and not stat.S_ISREG(mode):
        path.write_bytes(data)  # replacing /dev/null by a file would be a disaster; a directory raises here
        return
    target = Path(os.path.realpath(path))
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=".rdpi.", suffix=".part")
    try:
        with open(handle, "wb", buffering=0) as stream:
            os.chmod(temporary, _default_mode() if mode is None else stat.S_IMODE(mode))
            write_all(stream, data)  # before the rename, which may reach the disk first and leave an empty file
        os.replace(temporary, target)
    except BaseException:
        with suppress(FileNotFoundError):  # stopped when it was renamed already
            os.unlink(temporary)
        raise
    sync_folder(target.parent)


def _sync(handle: int) -> None:
    """To disk, if that is a thing that the file system, or the device or pipe, can do."""
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise


def _default_mode() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
