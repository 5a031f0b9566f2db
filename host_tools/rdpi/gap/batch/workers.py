"""Who works a plan off: processes on this machine, or a Dask cluster. Both give outcomes as tasks end."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from ...__main__ import one_thread
from ...errors import BadInput
from .plan import Task
from .work import Outcome, lost

ATTEMPTS = 5  # at a task whose worker dies
CONNECT_S = 15  # to a scheduler; also to one that went away
END_S = 5  # to a process, to end by itself

Work = Callable[[Task], Outcome]
DIED = f"the process that worked on it died, {ATTEMPTS} times; is there enough memory? Give fewer --jobs"


def on_this_machine(tasks: Sequence[Task], work: Work, count: int) -> Iterator[Outcome]:
    """Outcomes of tasks, from as many processes. The work of one that dies is begun again by another."""
    waiting = deque((task, 1) for task in tasks)
    busy: dict[Connection, tuple[BaseProcess, Task, int]] = {}
    idle: list[tuple[Connection, BaseProcess]] = []
    one_thread()
    try:
        while waiting or busy:
            while waiting and len(busy) < count:
                try:
                    connection, process = idle.pop() if idle else _start(work)
                except OSError as error:
                    if not busy:
                        raise BadInput(f"no process can be started ({error.strerror or error}); close other programs, "
                                       "or raise the limits of this account (ulimit)") from None
                    count = len(busy)  # those that there are go on
                    break
                task, attempt = waiting.popleft()
                try:
                    connection.send(task)
                except OSError:  # it died idle, which is not the task's doing
                    waiting.appendleft((task, attempt))
                    process.join()
                    continue
                busy[connection] = process, task, attempt
            for connection in wait([*busy]):
                process, task, attempt = busy.pop(connection)
                try:
                    outcome = connection.recv()
                except (EOFError, OSError):
                    process.join()
                    if attempt < ATTEMPTS:
                        waiting.appendleft((task, attempt + 1))
                    else:
                        yield lost(task, DIED)
                else:
                    idle.append((connection, process))
                    yield outcome
    finally:
        processes = [*(one for _, one in idle), *(one for one, *_ in busy.values())]
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(END_S)
            process.kill()


def _start(work: Work) -> tuple[Connection, BaseProcess]:
    context = multiprocessing.get_context("spawn")  # a fork would share the threads' locks
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, work), daemon=True)
    process.start()
    there.close()  # so that its end is seen here
    return here, process


def _serve(connection: Connection, work: Work) -> None:
    """In the process: tasks in, outcomes out, until the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all of a terminal's processes; one ends the others
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # nothing half written stays behind
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            connection.send(work(connection.recv()))


def _end_with_parent() -> None:
    wait([multiprocessing.parent_process().sentinel])
    os._exit(1)


def on_cluster(tasks: Sequence[Task], work: Work, address: str) -> Iterator[Outcome]:
    """Outcomes of tasks, from the workers of a Dask scheduler.

    They need the same rdpi, and the files under the same paths. Raises BadInput where there is no scheduler, or no
    longer one.
    """
    try:
        import dask
        from distributed import Client, Security, as_completed
        from distributed.comm import connect
    except ImportError:
        raise BadInput("--scheduler: needs the Python package distributed; install it (Debian: python3-distributed)"
                       ) from None
    dask.config.set({"distributed.comm.timeouts.connect": CONNECT_S})
    logging.disable(logging.CRITICAL)  # distributed would tell of a scheduler that is lost, with tracebacks

    async def call() -> None:
        line = await connect(address, timeout=CONNECT_S, **Security().get_connection_args("client"))
        await line.close()

    try:
        try:  # first, for a client that cannot connect holds up the program's end, with a traceback
            asyncio.run(call())
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # noqa: BLE001 - each kind of address has its own
            raise BadInput(f"--scheduler {address}: no Dask scheduler answers there ({error}); start one with "
                           "`dask scheduler`, or check the address") from None
        yield from _from(client, as_completed, tasks, work, address)
    finally:
        logging.disable(logging.NOTSET)


def _from(client: Any, as_completed: Callable[..., Any], tasks: Sequence[Task], work: Work,
          address: str) -> Iterator[Outcome]:
    """The same, from a client of the package distributed."""
    with client:
        futures = {client.submit(work, task, pure=False, retries=ATTEMPTS): task for task in tasks}
        for future in as_completed(futures, loop=client.loop):
            yield _outcome(future, futures[future], address)
            future.release()


def _outcome(future: Any, task: Task, address: str) -> Outcome:
    """Of a future that has ended. Raises BadInput if it ended because the scheduler is no more."""
    # A connection is lost while what it has made is asked for. Where that is between the last two steps of result(),
    # distributed raises the outcome itself, which is no exception: a TypeError.
    with suppress(OSError, asyncio.CancelledError, concurrent.futures.CancelledError, TypeError):
        if not future.cancelled():
            error = future.exception()
            return future.result() if error is None else lost(
                task, f"the cluster gave it up: {type(error).__name__}: {error}")
    raise BadInput(f"--scheduler {address}: the scheduler went away; what ended is not lost: the same command goes on "
                   "from there")
