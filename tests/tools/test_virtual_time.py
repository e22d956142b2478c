"""The virtual clock: time passes by itself, in order, the same each time, without the outside world."""

import asyncio
import random
import threading
import time

import pytest

from tools.sim.virtual_time import START, VirtualTimeError, run


def test_an_hour_passes_in_no_time_and_exactly() -> None:
    async def main() -> float:
        await asyncio.sleep(3600.0)
        return asyncio.get_running_loop().time()

    began = time.monotonic()
    assert run(main()) == pytest.approx(START + 3600.0, abs=1e-6)
    assert time.monotonic() - began < 1.0


def test_timers_fire_in_order_of_time_not_of_creation() -> None:
    async def main() -> list[str]:
        order: list[str] = []
        loop = asyncio.get_running_loop()
        for delay, name in ((0.3, "c"), (0.1, "a"), (0.2, "b")):
            loop.call_later(delay, order.append, name)
        await asyncio.sleep(1.0)
        return order

    assert run(main()) == ["a", "b", "c"]


def test_a_timeout_costs_virtual_time_only() -> None:
    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(50.0):
                await asyncio.Event().wait()
        return asyncio.get_running_loop().time()

    assert run(main()) == pytest.approx(START + 50.0)


def _trace(seed: int) -> list[tuple[float, int, float]]:
    """Five tasks with random waits write into one list: time, who, what."""

    async def walk(who: int, rng: random.Random, trace: list[tuple[float, int, float]]) -> None:
        for _ in range(40):
            await asyncio.sleep(rng.expovariate(10.0))
            value = await asyncio.to_thread(rng.gauss, 0.0, 1.0)
            trace.append((asyncio.get_running_loop().time(), who, value))

    async def main() -> list[tuple[float, int, float]]:
        trace: list[tuple[float, int, float]] = []
        rng = random.Random(seed)
        async with asyncio.TaskGroup() as group:
            for who in range(5):
                group.create_task(walk(who, rng, trace))
        return trace

    return run(main())


def test_same_seed_same_trace_to_the_last_bit() -> None:
    assert _trace(7) == _trace(7)
    assert _trace(7) != _trace(8)


def test_an_executor_works_in_place_and_hands_back_errors() -> None:
    def broken() -> None:
        raise KeyError("mine")

    async def main() -> int:
        with pytest.raises(KeyError, match="mine"):
            await asyncio.to_thread(broken)
        return await asyncio.to_thread(threading.get_ident)

    assert run(main()) == threading.get_ident()


def test_waiting_for_what_never_comes_is_named() -> None:
    async def waits_for_godot() -> None:
        await asyncio.Event().wait()

    async def main() -> None:
        await asyncio.create_task(waits_for_godot(), name="vladimir")

    named = r"deadlock at 1000\.000 s(.|\n)*vladimir: .*test_virtual_time\.py:\d+"
    with pytest.raises(VirtualTimeError, match=named):
        run(main())


def test_a_task_that_spins_is_found_out() -> None:
    async def main() -> None:
        while not asyncio.get_running_loop().is_closed():  # noqa: ASYNC110 - the very mistake
            await asyncio.sleep(0)

    with pytest.raises(VirtualTimeError, match="spins"):
        run(main())


@pytest.mark.parametrize(
    ("name", "reach_out"),
    [
        ("create_connection", lambda: asyncio.open_connection("127.0.0.1", 1)),
        ("create_unix_server", lambda: asyncio.start_unix_server(lambda reader, writer: None, "/nowhere")),
        ("subprocess_exec", lambda: asyncio.create_subprocess_exec("true")),
    ],
)
def test_the_outside_world_is_refused(name: str, reach_out) -> None:
    async def main() -> None:
        await reach_out()

    with pytest.raises(VirtualTimeError, match=f"{name} needs the outside world"):
        run(main())


def test_another_thread_may_not_report() -> None:
    refused: list[Exception] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()

        def report() -> None:
            try:
                loop.call_soon_threadsafe(print)
            except VirtualTimeError as error:
                refused.append(error)

        thread = threading.Thread(target=report, name="reporter")
        thread.start()
        thread.join()

    run(main())
    assert "reporter" in str(refused[0])
