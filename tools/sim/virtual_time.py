"""An asyncio event loop whose clock is a number: waiting costs nothing, and every run is the same run.

The loop sleeps by setting its clock to the next timer. Nothing outside the program can wake it, so whatever
would need the outside world (sockets, pipes, child processes, other threads) is refused; work given to an
executor runs at once, in place.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any, NoReturn, TypeVar

T = TypeVar("T")

# Not zero: code that takes 0 for "never" is wrong on a real machine too, but only just after boot.
START = 1000.0

# A program that goes round this often without its clock moving waits for something by spinning.
MAX_TURNS_AT_ONE_INSTANT = 100_000

_NEEDS_THE_OUTSIDE_WORLD = (
    *("add_reader", "add_writer", "add_signal_handler", "connect_read_pipe", "connect_write_pipe"),
    *("connect_accepted_socket", "create_connection", "create_datagram_endpoint", "create_server"),
    *("create_unix_connection", "create_unix_server", "getaddrinfo", "getnameinfo", "sendfile", "start_tls"),
    *("sock_accept", "sock_connect", "sock_recv", "sock_recv_into", "sock_recvfrom", "sock_recvfrom_into"),
    *("sock_sendall", "sock_sendfile", "sock_sendto", "subprocess_exec", "subprocess_shell"),
)


class VirtualTimeError(RuntimeError):
    """The program needs what a virtual clock can't give: the outside world, or an event that never comes."""


class VirtualTimeLoop(asyncio.BaseEventLoop):
    """Runs callbacks in the order of their virtual times; `time()` moves only between callbacks."""

    def __init__(self, start: float = START) -> None:
        super().__init__()
        self._now = start
        self._turns = 0
        self._owner = threading.get_ident()
        self._selector = self  # BaseEventLoop waits by `self._selector.select(timeout)`
        self._clock_resolution = 1e-9

    def time(self) -> float:
        return self._now

    def select(self, timeout: float | None) -> list[Any]:
        """Called once a turn with the seconds to the next timer; 0: a callback is ready, None: nothing is."""
        if timeout is None:
            what = f"deadlock at {self._now:.3f} s: no timer is set and every task waits"
            raise VirtualTimeError(f"{what}\n{self._waits()}")
        self._turns = 0 if timeout > 0.0 else self._turns + 1
        if self._turns > MAX_TURNS_AT_ONE_INSTANT:
            raise VirtualTimeError(f"the clock stands at {self._now:.3f} s: some task spins\n{self._waits()}")
        self._now += max(timeout, 0.0)
        return []

    def run_in_executor(self, executor: Any, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:
        """Runs `func` now, in this thread, in no virtual time; the future is done on return."""
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def call_soon_threadsafe(self, callback: Callable[..., object], *args: Any, context: Any = None) -> asyncio.Handle:
        if threading.get_ident() != self._owner:
            thread = threading.current_thread().name
            raise VirtualTimeError(f"thread {thread!r} reports to a virtual clock: use an executor instead")
        return self.call_soon(callback, *args, context=context)

    def _process_events(self, event_list: list[Any]) -> None:
        """Nothing outside ever happens."""

    def _waits(self) -> str:
        lines = []
        for task in asyncio.all_tasks(self):
            frames = task.get_stack(limit=1)
            where = f"{frames[0].f_code.co_filename}:{frames[0].f_lineno}" if frames else "not started"
            lines.append(f"  {task.get_name()}: {where}")
        return "\n".join(sorted(lines))


def _refusal(name: str) -> Callable[..., NoReturn]:
    def refuse(self: VirtualTimeLoop, *args: object, **kwargs: object) -> NoReturn:
        raise VirtualTimeError(f"{name} needs the outside world, absent in virtual time: use an adapter in memory")

    return refuse


for _name in _NEEDS_THE_OUTSIDE_WORLD:
    setattr(VirtualTimeLoop, _name, _refusal(_name))


def run(main: Coroutine[Any, Any, T], start: float = START) -> T:
    """asyncio.run in virtual time."""
    with asyncio.Runner(loop_factory=lambda: VirtualTimeLoop(start)) as runner:
        return runner.run(main)
