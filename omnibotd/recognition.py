"""Which of several maps is this? On wake-up, and when the robot was moved, the right one is known by its ceiling.

The active map has the first word. When it does not recognise what a resting robot sees, the others are shown the same
few frames, one map at a time on the worker thread; only a clear winner is switched to.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from omnibotd.control import ControlLoop
from omnibotd.core.errors import CoreError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.navigator import SURE
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, correlate, harmonics
from omnibotd.core.vision.frame import Frame
from omnibotd.io.camera import Camera
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.perception import OffLoop, Perception

log = logging.getLogger(__name__)

PERIOD = 0.5  # s between looks at how the active map does: perception's own period at rest
FRAMES = 6  # shown to each map; a localizer learns little more from a view that stays the same
FRAME_GAP = 0.15  # s between them, so that exposure and noise differ
CLEARLY = 0.2  # confidence by which a map must lead over the active one and over every other
# s for all maps together. The worker is shared with the localizer of the active map, which has a turn between any two
# steps; twenty maps of 4000 nodes take some ten seconds.
LIMIT = 60.0
MOVED, TURNED = 0.3, 0.5  # m, rad by odometry since the last attempt that make another worth while
OTHER_VIEW = 0.4  # correlation with the view of the last attempt below which the robot was carried

Shown = tuple[Frame, Pose2D]


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Where the last attempt was made, and what was seen there."""

    odom_from_base: Pose2D
    view: Harmonics


class Recogniser:
    """Chooses among the stored maps while nothing else is going on; never in the middle of a job or a recording."""

    def __init__(
        self, control: ControlLoop, perception: Perception, camera: Camera, store: MapStore, off_loop: OffLoop
    ) -> None:
        self._control, self._perception, self._camera = control, perception, camera
        self._store, self._off_loop = store, off_loop
        self._last: _Attempt | None = None
        self._unsure = 0  # looks in a row at which the active map did not know where the robot is
        self._attempting = asyncio.Lock()
        self._descriptor: Descriptor | None = None

    async def run(self) -> None:
        """Watch for a robot that rests under a ceiling its map does not know, for ever."""
        await self._perception.lens_known.wait()
        while True:
            await asyncio.sleep(PERIOD)
            if self._confidence() >= SURE:
                self._last = None  # it knows its way: not to know it any more will be news
            self._unsure = self._unsure + 1 if self.idle() and self._confidence() < SURE else 0
            if self._unsure >= FRAMES:
                self._unsure = 0
                if await self._elsewhere():
                    await self.recognise()

    async def wake_up(self) -> None:
        """On request: give the active map a few frames, then the others."""
        if not await asyncio.to_thread(self._others):
            return
        for _ in range(FRAMES):
            await asyncio.sleep(PERIOD)
            if self._confidence() >= SURE:
                return
        await self.recognise()

    async def recognise(self) -> str | None:
        """Try the other maps now; the name of the one switched to, None where none is the clear winner."""
        async with self._attempting:
            names = await asyncio.to_thread(self._others)
            if not names or not self.idle() or self._confidence() >= SURE:
                return None
            shown = await self._look()
            if not shown:
                return None
            await self._remember(*shown[-1])
            best = self._clear_winner(await self._compare(names, shown))
            return None if best is None else await self._switch(best)

    async def chosen(self) -> None:
        """Somebody has said which map to use: that holds until the robot is moved."""
        frame = self._camera.latest
        if frame is not None and self._perception.model is not None:
            await self._remember(frame, self._control.odometry.odom_from_base)

    async def _remember(self, frame: Frame, odom_from_base: Pose2D) -> None:
        """Here nothing needs to be tried again."""
        try:
            self._last = _Attempt(odom_from_base, await self._off_loop(self._seen, frame))
        except CoreError as error:
            log.warning("frame not used: %s", error)

    def idle(self) -> bool:
        """Whether the robot has nothing to do: no job, nobody at the wheels, nothing recorded, no map being loaded."""
        return not self._control.moving and self._control.recorder is None and self._perception.loading is None

    def _confidence(self) -> float:
        """With which the active map knows where the robot is, 0 where there is none."""
        return self._control.place.confidence if self._control.place is not None else 0.0

    async def _elsewhere(self) -> bool:
        """Whether another attempt can end otherwise than the last: the robot was driven, turned or carried since."""
        last, frame = self._last, self._camera.latest
        if last is None:
            return True
        step = last.odom_from_base.inverse() @ self._control.odometry.odom_from_base
        if math.hypot(step.x, step.y) > MOVED or abs(step.yaw) > TURNED:
            return True
        if frame is None:
            return False
        try:
            view = await self._off_loop(self._seen, frame)
        except CoreError:
            return False
        return bool(correlate(view, last.view[None])[1][0] < OTHER_VIEW)

    def _seen(self, frame: Frame) -> Harmonics:
        """On the worker: the view, to be compared with another."""
        if self._descriptor is None:
            assert self._perception.model is not None
            self._descriptor = Descriptor(self._perception.model)
        return harmonics(self._descriptor.view(frame))

    async def _look(self) -> list[Shown]:
        """A few frames and the odometry at each; none where the robot did not rest or the camera fell silent."""
        shown: list[Shown] = []
        stamp = -math.inf
        for _ in range(FRAMES):
            try:
                async with asyncio.timeout(2.0):
                    frame = await self._camera.wait_newer(stamp)
            except TimeoutError:
                return []
            self._control.absorb()
            shown.append((frame, self._control.odometry.at(frame.stamp)))
            stamp = frame.stamp + FRAME_GAP
            if not self.idle():
                return []
        return shown

    def _others(self) -> list[str]:
        """Maps that could be meant instead."""
        active = self._perception.topo_map
        return [entry.name for entry in self._store.list() if entry.nodes and (not active or entry.name != active.name)]

    async def _compare(self, names: Sequence[str], shown: Sequence[Shown]) -> dict[str, float]:
        """The confidence with which each map knows the view; one map is in memory at a time."""
        known: dict[str, float] = {}
        end = asyncio.get_running_loop().time() + LIMIT
        for tried, name in enumerate(names):
            if asyncio.get_running_loop().time() > end:
                log.warning("recognising the map took too long; not tried: %s", ", ".join(names[tried:]))
                break
            try:
                known[name] = await self._try(name, shown)
                log.info("map %s knows this view with confidence %.2f", name, known[name])
            except (MapStoreError, CoreError) as error:
                log.warning("map %s not considered: %s", name, error)
            if not self.idle():
                return {}
        return known

    async def _try(self, name: str, shown: Sequence[Shown]) -> float:
        assert self._perception.model is not None
        topo_map = await asyncio.to_thread(self._store.load, name)
        localizer = await self._perception.localizer_of(topo_map, self._perception.model)
        confidence = 0.0
        for frame, odom_from_base in shown:
            confidence = (await self._off_loop(localizer.update, frame, odom_from_base)).confidence
        return confidence

    def _clear_winner(self, known: Mapping[str, float]) -> str | None:
        best = max(known, key=lambda name: known[name], default=None)
        if best is None or known[best] < SURE:
            return None
        others = [confidence for name, confidence in known.items() if name != best]
        if known[best] - max([self._confidence(), *others]) < CLEARLY:
            log.info("more than one map knows this view: say map use NAME")
            return None
        return best

    async def _switch(self, name: str) -> str | None:
        before = self._perception.topo_map.name if self._perception.topo_map else None
        try:
            topo_map = await asyncio.to_thread(self._store.load, name)
            if not self.idle():
                return None
            await self._perception.use(topo_map)
            await asyncio.to_thread(self._store.set_active, name)
        except (MapStoreError, CoreError) as error:  # deleted meanwhile, or the disk is full
            log.error("map %s was recognised, but can't be used: %s", name, error)
            return None
        log.info("map %s recognised by its ceiling and in use, before it %s", name, before or "none")
        self._control.events({"event": "map_recognised", "map": name, "before": before})
        return name
