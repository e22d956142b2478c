"""The socket's language: what is a request, what each other line is answered with, in bounded memory."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnibotd import control_protocol as protocol
from omnibotd.control_protocol import LineDecoder, ProtocolError, Request, RpcError
from omnibotd.core.error_name import ErrorName


def line(**members: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", **members}).encode() + b"\n"


def test_a_request_carries_id_method_and_params() -> None:
    received = LineDecoder().feed(line(id=7, method="goto", params={"place": "Küche"}))
    assert received == [Request(7, "goto", {"place": "Küche"})]


def test_without_id_it_is_a_notification_and_params_may_be_left_out() -> None:
    assert LineDecoder().feed(line(method="stop")) == [Request(None, "stop", {})]


def test_blank_lines_say_nothing() -> None:
    assert LineDecoder().feed(b"\n\r\n  \n" + line(id=1, method="stop")) == [Request(1, "stop", {})]


@given(st.integers(1, 200))
def test_any_cut_of_the_stream_gives_the_same_requests(size: int) -> None:
    stream = line(id=1, method="a") + b"garbage\n" + line(id="x", method="b", params={"k": [1, None]})
    decoder = LineDecoder()
    pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
    received = [message for piece in pieces for message in decoder.feed(piece)]
    assert received == LineDecoder().feed(stream)
    assert len(received) == 3


@pytest.mark.parametrize(
    ("bad", "code", "request_id"),
    [
        (b"garbage\n", -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"stop"\n', -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"\xff"}\n', -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"m","params":{"a":NaN}}\n', -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"m","params":{"a":-Infinity}}\n', -32700, None),
        (b'{"jsonrpc":"2.0","id":1,"method":"m","params":{"a":1e999}}\n', -32700, None),
        (b"[" * 60000 + b"\n", -32700, None),
        (b"7" * 60000 + b"\n", -32700, None),
        (b'"stop"\n', -32600, None),
        (b"[" + line(id=1, method="stop").strip() + b"]\n", -32600, None),
        (b"[]\n", -32600, None),
        (b'{"jsonrpc":"1.0","id":3,"method":"stop"}\n', -32600, 3),
        (b'{"id":3,"method":"stop"}\n', -32600, 3),
        (line(id=None, method="stop"), -32600, None),
        (line(id=True, method="stop"), -32600, None),
        (line(id=1.5, method="stop"), -32600, None),
        (line(id=[1], method="stop"), -32600, None),
        (line(id=2**80, method="stop"), -32600, None),
        (line(id="x" * 1000, method="stop"), -32600, None),
        (line(id=4), -32600, 4),
        (line(id=4, method=4), -32600, 4),
        (line(id=4, method=""), -32600, 4),
        (line(id="p", method="stop", params=[1]), -32602, "p"),
        (line(id="p", method="stop", params=None), -32602, "p"),
    ],
)
def test_every_other_line_is_answered_with_its_code(bad: bytes, code: int, request_id: object) -> None:
    decoder = LineDecoder()
    [error, after] = decoder.feed(bad + line(id=9, method="stop"))
    assert isinstance(error, ProtocolError)
    assert (error.code, error.id) == (code, request_id)
    assert error.message
    assert after == Request(9, "stop", {})


@given(st.binary(max_size=300))
def test_no_bytes_raise(data: bytes) -> None:
    decoder = LineDecoder()
    decoder.feed(data)
    assert decoder.feed(b"\n" + line(id=9, method="stop"))[-1] == Request(9, "stop", {})


def test_the_longest_line_passes_and_one_byte_more_is_one_error() -> None:
    request = line(id=1, method="m", params={"a": ""}).strip()
    longest = request.replace(b'""', b'"' + b"a" * (protocol.MAX_LINE - len(request)) + b'"')
    assert len(longest) == protocol.MAX_LINE
    [fits] = LineDecoder().feed(longest + b"\n")
    assert isinstance(fits, Request)
    [error] = LineDecoder().feed(longest + b" \n")
    assert isinstance(error, ProtocolError)
    assert error.code == -32700


def test_an_overlong_line_is_told_once_and_thrown_away_up_to_its_newline() -> None:
    decoder = LineDecoder()
    received = [message for _ in range(100) for message in decoder.feed(b"x" * 10_000)]
    assert [type(message) for message in received] == [ProtocolError]
    assert decoder.discarded == 1_000_000
    assert decoder.feed(b"rest\n" + line(id=1, method="stop")) == [Request(1, "stop", {})]
    assert decoder.discarded == 0


@pytest.mark.parametrize("name", list(ErrorName))
def test_every_error_name_has_the_code_of_the_contract(name: ErrorName) -> None:
    refused = {ErrorName.BUSY, ErrorName.EMERGENCY_STOP, ErrorName.NOT_PERMITTED, ErrorName.NOT_DOCKED}
    expected = 4 if name in refused else {"CANCELLED": 130, "INVALID": -32602}.get(name, 1)
    assert RpcError.named(name, "why").code == expected


def test_answers_are_one_line_of_json_each() -> None:
    error = protocol.encode_error(3, 4, "a job\nis running", ErrorName.BUSY)
    assert error.count(b"\n") == 1
    assert json.loads(error) == {
        "jsonrpc": "2.0",
        "id": 3,
        "error": {"code": 4, "message": "a job\nis running", "data": {"name": "BUSY"}},
    }
    assert json.loads(protocol.encode_response("a", {"x": 1})) == {
        "jsonrpc": "2.0",
        "id": "a",
        "result": {"x": 1},
    }
    assert json.loads(protocol.encode_notification("event", {"stamp": 1.5})) == {
        "jsonrpc": "2.0",
        "method": "event",
        "params": {"stamp": 1.5},
    }


def test_a_number_that_is_not_known_goes_out_as_null() -> None:
    result = {"sigma": float("nan"), "pose": [1.0, float("inf")], "job": {"left": float("-inf")}}
    answer = json.loads(protocol.encode_response(1, result))
    assert answer["result"] == {"sigma": None, "pose": [1.0, None], "job": {"left": None}}


def test_what_the_client_encodes_the_server_decodes() -> None:
    assert LineDecoder().feed(protocol.encode_request(5, "drive", {"vx": -0.1})) == [Request(5, "drive", {"vx": -0.1})]


def test_the_language_needs_no_numpy() -> None:
    code = "import omnibotd.control_protocol, sys; sys.exit('numpy' in sys.modules or 'asyncio' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
