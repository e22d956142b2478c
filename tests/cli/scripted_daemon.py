"""A daemon of scripted answers, for what talks to one."""

from __future__ import annotations

import asyncio
import base64
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_server import ControlServer, Session

Params = dict[str, Any]
PNG = b"\x89PNG\r\n\x1a\n" + bytes(200_000)

STATUS: Params = {
    "version": "0.1.0",
    "uptime_s": 3725.0,
    "state": "IDLE",
    "map": "flat",
    "pose": {"x": 1.0, "y": -2.0, "yaw": 1.5707963},
    "confidence": 0.98,
    "sigma": 0.03,
    "place": "kitchen",
    "battery": 14.83,
    "charging": True,
    "job": None,
    "recording": None,
    "base": {"connected": True, "driver": "create2", "board": "Roomba", "firmware": "3.5", "reason": ""},
    "camera": {"source": "/dev/video0", "ok": True, "rate_hz": 24.96, "age_s": 0.04, "width": 640, "height": 480},
    "loop": {"period_ms": 50.0, "late_ms_p99": 1.25, "late_ms_max": 3.5, "ticks": 100},
    "memory_mb": 84.2,
}
ANSWERS: dict[str, Params] = {
    "status": STATUS,
    "stop": {},
    "drive": {},
    "record.start": {"map": "flat", "path": "/maps/recordings/flat.0001.mcap"},
    "record.stop": {
        "map": "flat",
        "seconds": 301.0,
        "distance_m": 61.25,
        "frames": 3010,
        "bytes": 120_500_000,
        "coverage_m2": 14.5,
        "warnings": ["a plain ceiling: expect less accuracy"],
    },
    "map.list": {
        "maps": [
            {"name": "flat", "nodes": 1200, "bytes": 900_000, "active": True, "trained": True, "recording_bytes": 0},
            {"name": "attic", "nodes": 0, "bytes": 0, "active": False, "trained": False, "recording_bytes": 5_000},
            {"name": "old", "nodes": None, "bytes": 12, "active": False, "trained": True, "recording_bytes": 0},
        ]
    },
    "map.use": {"map": "flat", "nodes": 1200},
    "map.info": {
        "map": "flat",
        "nodes": 1200,
        "links": {"odometry": 1199, "similarity": 300, "proximity": 50},
        "bytes": 900_000,
        "places": {"desk": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
        "docks": {},
        "ceiling_height": None,
        "statistics": {"topographic_error": 0.0512},
    },
    "map.plot": {"map": "flat", "png": base64.b64encode(PNG).decode()},
    "map.verify": {"ok": True, "sections": [{"name": "poses", "bytes": 14400, "ok": True}], "message": "all is well"},
    "place.add": {"name": "desk", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
    "place.list": {"places": {"desk": {"x": -1.0, "y": 2.0, "yaw": 3.1415927}}, "docks": {}},
    "place.rename": {"name": "table", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
    "place.delete": {},
    "map.prune": {"map": "flat", "nodes": 800, "nodes_before": 1200, "bytes": 600_000, "kept": "/maps/flat.omap~"},
    "map.delete": {"map": "flat", "kept": "/maps/flat.omap~"},
    "train": {"map": "flat", "nodes": 1200, "links": {"odometry": 1199}, "seconds": 42.0, "warnings": []},
    "goto": {"place": "kitchen", "pose": {"x": 3.0, "y": 4.0, "yaw": 0.0}, "seconds": 12.5, "error_estimate_m": 0.04},
    "route": {
        "places": ["desk", "sofa"],
        "loops": 1,
        "seconds": 75.0,
        "arrived": 2,
        "arrivals": [
            {"place": "desk", "loop": 1, "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}, "seconds": 30.5},
            {"place": "sofa", "loop": 1, "pose": {"x": -1.0, "y": 0.5, "yaw": 3.1415927}, "seconds": 75.0},
        ],
    },
    "relocalise": {
        "map": "flat",
        "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0},
        "confidence": 0.934,
        "sigma": 0.03,
        "seconds": 4.2,
    },
    "dock": {"dock": "home", "seconds": 20.0, "retries": 1},
    "dock.save": {"name": "home", "pose": {"x": 0.0, "y": 0.0, "yaw": 0.0}},
    "undock": {"dock": "home", "seconds": 7.5, "distance_m": 0.503},
    "calibrate.spin": {
        "calibration": "spin",
        "file": "/maps/calibration/spin.yaml",
        "centre": [319.2, 240.1],
        "tilt": [0.0175, -0.0087],
        "centre_sigma_px": 0.11,
        "tilt_sigma_deg": 0.02,
        "residual": "0.31 px",
        "message": "the camera leans by 1.1 degrees",
        "effect": "takes effect at the next start of omnibotd",
    },
    "calibrate.base": {
        "calibration": "base",
        "file": "/maps/calibration/base.yaml",
        "wheel_radius": 0.0361,
        "wheel_ratio": 1.0021,
        "wheel_separation": 0.2312,
        "residual": "0.20%",
        "message": "good to 0.2 %",
        "effect": "takes effect at the next start of omnibotd",
    },
    "calibrate.camera": {
        "calibration": "camera",
        "file": "/maps/calibration/camera.yaml",
        "rms_px": 0.314,
        "covered_deg": 84.2,
        "edge_sigma_px": 0.43,
        "message": "",
        "effect": "takes effect at the next start of omnibotd",
        "warnings": ["maps taught before may be refused"],
    },
}


class Daemon:
    """Answers as scripted, in a thread of its own, and remembers what it was asked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.answers = dict(ANSWERS)
        self.asked: list[tuple[str, Params]] = []
        self.failure: RpcError | None = None
        self.feedback: list[Params] = []
        self.pending = False  # answer jobs only after a stop
        self.stopped = asyncio.Event()
        self._loop = asyncio.new_event_loop()
        self._server = ControlServer(path, "no-such-group", self._dispatch)
        self._thread = threading.Thread(target=self._loop.run_forever)

    def start(self) -> None:
        self._thread.start()
        self.run(self._server.start())

    def run(self, work: Any) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(5)

    def close(self) -> None:
        self.run(self._server.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def tell(self, event: Params) -> None:
        self._loop.call_soon_threadsafe(self._server.broadcast, event)

    async def _dispatch(
        self, session: Session, method: str, params: Params, feedback: Callable[[Params], None]
    ) -> Params:
        self.asked.append((method, params))
        if method == "stop":
            self.stopped.set()
            return {}
        for values in self.feedback:
            feedback(values)
        if self.pending:
            await self.stopped.wait()
            raise RpcError.named(ErrorName.CANCELLED, "stopped on request")
        if self.failure is not None:
            raise self.failure
        return self.answers[method]
