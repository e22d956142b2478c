"""Worlds plugged in by name, MODULE:FACTORY: what one must offer, and what to say of one that does not."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from typing import Any, Protocol, cast

import numpy as np

from omnibotd.core.vision.frame import Image


class WorldError(Exception):
    """A world that can't be loaded, or lacks what a world must have."""


class World(Protocol):
    """A room to plug in; metres and radians, REP-103, image top = robot front."""

    @property
    def fov_deg(self) -> float: ...

    @property
    def bounds(self) -> tuple[float, float, float, float]: ...

    @property
    def dock(self) -> tuple[float, float, float]: ...

    def free(self, x: float, y: float, radius: float) -> bool: ...

    def render(self, x: float, y: float, yaw: float, t: float) -> Image: ...


def load_world(name: str, seed: int) -> World:
    """The world that MODULE:FACTORY makes of `seed`; raises WorldError saying what it lacks."""
    return _made(name, seed, {})


def relit_world(name: str, seed: int, light: str) -> World | None:
    """The same room under another light; None where its factory takes no `light`, or not this one."""
    if "light" not in inspect.signature(find_factory(name)).parameters:
        return None
    try:
        return _made(name, seed, {"light": light})
    except WorldError as error:
        if isinstance(error.__cause__, ValueError):
            return None
        raise


def find_factory(name: str) -> Callable[..., Any]:
    """The function that MODULE:FACTORY names; WorldError where there is none."""
    module_name, _, factory_name = name.partition(":")
    if not module_name or not factory_name:
        raise WorldError(f"world {name!r}: expected MODULE:FACTORY, such as tools.sim.ceilings:tiles")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise WorldError(f"world {name!r}: {error}; is its folder on PYTHONPATH?") from error
    factory = getattr(module, factory_name, None)
    if not callable(factory):
        raise WorldError(f"world {name!r}: module {module_name} has no function {factory_name}")
    return cast("Callable[..., Any]", factory)


def _made(name: str, seed: int, options: dict[str, Any]) -> World:
    factory, factory_name = find_factory(name), name.partition(":")[2]
    try:
        world: World = factory(seed, **options)
    except Exception as error:
        raise WorldError(f"world {name!r}: {factory_name}({seed}) failed: {error!r}") from error
    problems = list(_lacks(world))
    if problems:
        raise WorldError(f"world {name!r}: " + "; ".join(problems))
    return world


def _lacks(world: Any) -> Iterator[str]:
    """What keeps an object from being a World, a sentence each."""
    missing = [key for key in ("render", "fov_deg", "free", "bounds", "dock") if not hasattr(world, key)]
    if missing:
        yield f"has no {', '.join(missing)}"
        return
    if not _numbers(world.fov_deg, None):
        yield f"fov_deg is {world.fov_deg!r}, expected degrees"
    if not _numbers(world.bounds, 4):
        yield f"bounds is {world.bounds!r}, expected (xmin, ymin, xmax, ymax)"
    if not _numbers(world.dock, 3):
        yield f"dock is {world.dock!r}, expected (x, y, yaw)"
        return
    if not isinstance(world.free(0.0, 0.0, 0.1), bool | np.bool_):
        yield "free(x, y, radius) must return a bool"
    image = world.render(*world.dock, 0.0)
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape[2:] != (3,):
        yield f"render returns {_described(image)}, expected an array (H, W, 3) of uint8, BGR"


def _numbers(values: Any, count: int | None) -> bool:
    """Whether these are `count` finite numbers; None: a single one."""
    shape = () if count is None else (count,)
    array = np.asarray(values)
    return array.shape == shape and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())


def _described(image: Any) -> str:
    return f"{image.shape} of {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
