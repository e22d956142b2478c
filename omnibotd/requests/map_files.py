"""Maps to and from a client's files, in pieces that fit the socket's lines: `map export` and `map import`.

The client reads and writes its files with its own rights; the daemon, which may have others, touches only its store.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import MAX_LINE, RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStoreError
from omnibotd.io.map_transfer import MAX_IMPORT, Incoming, read_piece, same_content
from omnibotd.requests.params import Params, invalid
from omnibotd.requests.robot import Method, Robot

PATIENCE = 30.0  # s after which an import that gets no more pieces makes room for another


class MapFiles:
    """Any number of exports, each a series of questions; one import at a time, whose pieces come in order."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._incoming: Incoming | None = None
        self._whose: Session | None = None
        self._heard = 0.0
        self._piece = asyncio.Lock()

    def methods(self) -> dict[str, Method]:
        return {
            "map.export": self._export,
            "map.import": self._import,
        }

    async def _export(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        """The bytes from `offset` on. The first answer's `version` goes with the next questions: all from one file."""
        name, offset = params.name("map"), params.whole("offset", 0, 0, MAX_IMPORT)
        version = params.text("version", 64) if "version" in params else None
        params.end()
        piece = await asyncio.to_thread(read_piece, self._robot.store, name, offset, version)
        data = base64.b64encode(piece.data).decode()
        return {"map": name, "bytes": piece.total, "version": piece.version, "offset": offset, "data": data}

    async def _import(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        """A piece of a map; the first begins the import, the last publishes it. One that is there is told at once."""
        name, offset = params.name("map"), params.whole("offset", 0, 0, MAX_IMPORT)
        total, sha256 = params.whole("bytes", None, 1, MAX_IMPORT), params.text("sha256", 64)
        data = _decoded(params.text("data", MAX_LINE))
        params.end()
        async with self._piece:
            if offset == 0 and await self._is_there(name, sha256):
                return {"map": name, "bytes": total, "received": total, "unchanged": True}
            incoming = self._begin(name, total, sha256, session) if offset == 0 else self._current(name, session)
            self._heard = self._robot.now()
            return await self._take(incoming, offset, data)

    async def _is_there(self, name: str, sha256: str) -> bool:
        same = await asyncio.to_thread(same_content, self._robot.store, name, sha256)
        if same is False:
            message = f"map {name!r} exists with other content: choose another name (--name), or delete it first"
            raise RpcError.named(ErrorName.STORAGE, message)
        return same is True

    def _begin(self, name: str, total: int, sha256: str, session: Session | None) -> Incoming:
        if self._incoming is not None:
            if self._whose is not session and self._robot.now() - self._heard < PATIENCE:
                message = f"map {self._incoming.name!r} is being imported; try again when it is done"
                raise RpcError.named(ErrorName.BUSY, message)
            self._discard()
        self._incoming, self._whose = Incoming(self._robot.store, name, total, sha256), session
        if session is not None:
            session.on_close(lambda: self._gone(session))
        return self._incoming

    def _current(self, name: str, session: Session | None) -> Incoming:
        if self._incoming is None or self._whose is not session or self._incoming.name != name:
            raise invalid(f"offset: no import of map {name!r} is running here; begin at offset 0")
        return self._incoming

    async def _take(self, incoming: Incoming, offset: int, data: bytes) -> dict[str, Any]:
        try:
            complete = await asyncio.to_thread(incoming.add, offset, data)
            nodes = await asyncio.to_thread(incoming.publish) if complete else None
        except MapStoreError:
            self._discard()
            raise
        answer = {"map": incoming.name, "bytes": incoming.total, "received": incoming.received}
        if nodes is None:
            if self._whose is not None and self._whose.closed:
                self._discard()
            return answer
        self._incoming = None
        return {**answer, "nodes": nodes, "unchanged": False}

    def _gone(self, session: Session) -> None:
        if self._whose is session and not self._piece.locked():  # else whoever works on a piece sees to it
            self._discard()

    def _discard(self) -> None:
        if self._incoming is not None:
            self._incoming.discard()
        self._incoming = self._whose = None


def _decoded(text: str) -> bytes:
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise invalid(f"data: no base64: {error}") from error
    if not data:
        raise invalid("data: expected at least one byte")
    return data
