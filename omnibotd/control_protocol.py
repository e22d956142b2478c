"""The control socket's language without I/O: JSON-RPC 2.0, one object a line, UTF-8."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, NoReturn

from omnibotd.core.error_name import ErrorName

MAX_LINE = 64 * 1024  # bytes; the longest sensible request is a few hundred, and 32 clients may each hold one line
_MAX_ID_LENGTH = 128  # an id comes back in every feedback line: a long one would multiply
_MAX_ID = 2**53  # whole numbers beyond are not exact in every JSON reader

PARSE_ERROR = -32700
INVALID_REQUEST = -32600
METHOD_NOT_FOUND = -32601
INVALID_PARAMS = -32602
INTERNAL_ERROR = -32603
JOB_FAILED = 1
REFUSED = 4
CANCELLED = 130

_CODES = {
    ErrorName.BUSY: REFUSED,
    ErrorName.EMERGENCY_STOP: REFUSED,
    ErrorName.NOT_PERMITTED: REFUSED,
    ErrorName.NOT_DOCKED: REFUSED,
    ErrorName.CANCELLED: CANCELLED,
    ErrorName.INVALID: INVALID_PARAMS,
}

RequestId = int | str | None


def code_of(name: ErrorName) -> int:
    """The error code that goes with a name: application codes are the exit codes omnibotctl ends with."""
    return _CODES.get(name, JOB_FAILED)


class RpcError(Exception):
    """What a request is answered with instead of a result; `message` is one sentence for a person, `report` the facts
    behind it: what was seen, what was expected."""

    def __init__(self, code: int, name: ErrorName, message: str, report: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.name = name
        self.message = message
        self.report = dict(report or {})

    @classmethod
    def named(cls, name: ErrorName, message: str, report: Mapping[str, Any] | None = None) -> RpcError:
        return cls(code_of(name), name, message, report)


class Request(NamedTuple):
    """One call; `id` is None for a notification, which gets no answer."""

    id: RequestId
    method: str
    params: dict[str, Any]


class ProtocolError(NamedTuple):
    """A line that is no request: answer with `code` and `message` under `id` (None: none could be read)."""

    code: int
    message: str
    id: RequestId = None


class LineSplitter:
    """Bytes in, lines out, in bounded memory; None stands for a line longer than `limit`, told once.

    `discarded` counts the bytes thrown away of the overlong line that is still running, 0 when there is none.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._rest = bytearray()
        self.discarded = 0

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        *ends, rest = data.split(b"\n")
        for end in ends:
            yield from self._take(end, ended=True)
        yield from self._take(rest, ended=False)

    def _take(self, piece: bytes, *, ended: bool) -> Iterator[bytes | None]:
        if self.discarded:
            self.discarded = 0 if ended else self.discarded + len(piece)
            return
        if len(self._rest) + len(piece) > self._limit:
            self.discarded = 0 if ended else len(self._rest) + len(piece)
            self._rest.clear()
            yield None
            return
        self._rest += piece
        if ended:
            line = bytes(self._rest)
            self._rest.clear()
            yield line


class LineDecoder:
    """Turns what a client sends into requests; whatever else it sends becomes a ProtocolError."""

    def __init__(self) -> None:
        self._lines = LineSplitter(MAX_LINE)

    @property
    def discarded(self) -> int:
        """Bytes thrown away so far of an overlong line that has not ended yet."""
        return self._lines.discarded

    def feed(self, data: bytes) -> list[Request | ProtocolError]:
        """Everything that `data` completes, in order; blank lines say nothing."""
        return [
            ProtocolError(PARSE_ERROR, f"line longer than {MAX_LINE} bytes") if line is None else _request(line)
            for line in self._lines.feed(data)
            if line is None or line.strip()
        ]


def _request(line: bytes) -> Request | ProtocolError:
    try:
        message = parse(line)
    except ValueError as error:
        return ProtocolError(PARSE_ERROR, f"not a line of JSON in UTF-8: {error}")
    if isinstance(message, list):
        return ProtocolError(INVALID_REQUEST, "batches are not supported: send one object a line")
    if not isinstance(message, dict):
        return ProtocolError(INVALID_REQUEST, "a request is a JSON object")
    return _checked(message)


def _checked(message: dict[str, Any]) -> Request | ProtocolError:
    request_id = message.get("id")
    if "id" in message and not _valid_id(request_id):
        return ProtocolError(INVALID_REQUEST, "id must be a short string or a whole number")
    if message.get("jsonrpc") != "2.0":
        return ProtocolError(INVALID_REQUEST, 'jsonrpc must be "2.0"', request_id)
    method = message.get("method")
    if not isinstance(method, str) or not method:
        return ProtocolError(INVALID_REQUEST, "method must be a string", request_id)
    params = message.get("params", {})
    if not isinstance(params, dict):
        return ProtocolError(INVALID_PARAMS, "params must be an object: parameters go by name", request_id)
    return Request(request_id, method, params)


def _valid_id(value: object) -> bool:
    if isinstance(value, str):
        return len(value) <= _MAX_ID_LENGTH
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _MAX_ID


def parse(line: bytes) -> Any:
    """Strict JSON: finite numbers, UTF-8, bounded nesting. Raises ValueError with the reason."""
    try:
        return json.loads(line.decode(), parse_constant=_no_number, parse_float=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"number {text[:20]} is out of range")
    return value


def encode_request(request_id: RequestId, method: str, params: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": "2.0", "id": request_id, "method": method, "params": params})


def encode_response(request_id: RequestId, result: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": "2.0", "id": request_id, "result": result})


def encode_error(
    request_id: RequestId,
    code: int,
    message: str,
    name: str = ErrorName.INVALID,
    report: Mapping[str, Any] | None = None,
) -> bytes:
    data = {"name": name, "report": report} if report else {"name": name}
    error = {"code": code, "message": message, "data": data}
    return _line({"jsonrpc": "2.0", "id": request_id, "error": error})


def encode_notification(method: str, params: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": "2.0", "method": method, "params": params})


def _line(message: dict[str, Any]) -> bytes:
    """One line; JSON has no NaN or infinity, so a number that is not known goes out as null."""
    try:
        text = json.dumps(message, allow_nan=False, separators=(",", ":"))
    except ValueError:
        text = json.dumps(nulled(message), allow_nan=False, separators=(",", ":"))
    return text.encode() + b"\n"


def nulled(value: Any) -> Any:
    """The same with null for every number that JSON has no word for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: nulled(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [nulled(item) for item in value]
    return value
