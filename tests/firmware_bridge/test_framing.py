"""Frames survive any cutting of the stream; the decoder survives anything at all."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.events import BridgeError
from firmware_bridge.framing import MAX_ENCODED, MAX_PAYLOAD, Decoder, Frame, encode

frames = st.builds(Frame, st.integers(0, 255), st.integers(0, 255), st.binary(min_size=0, max_size=MAX_PAYLOAD))


def line_of(frame: Frame) -> bytes:
    return encode(frame.kind, frame.seq, frame.payload)


@settings(derandomize=True)
@given(st.lists(frames, max_size=6), st.lists(st.integers(1, 90), min_size=1, max_size=20))
def test_round_trip_however_cut(sent: list[Frame], cuts: list[int]) -> None:
    stream = b"".join(map(line_of, sent))
    decoder, received, at = Decoder(), [], 0
    while at < len(stream):
        size = cuts[at % len(cuts)]
        received += decoder.feed(stream[at : at + size])
        at += size
    assert received == sent
    assert (decoder.crc_errors, decoder.overruns, decoder.garbage) == (0, 0, 0)


@settings(derandomize=True)
@given(st.lists(st.binary(max_size=300), max_size=8), frames)
def test_any_bytes_then_resynchronises_on_the_next_frame(noise: list[bytes], frame: Frame) -> None:
    decoder = Decoder()
    for piece in noise:
        decoder.feed(piece)
        assert len(decoder._partial) <= MAX_ENCODED
    decoder.feed(b"\0")
    assert decoder.feed(line_of(frame)) == [frame]


@settings(derandomize=True)
@given(frames, st.data())
def test_no_single_bit_error_gets_through(frame: Frame, data: st.DataObject) -> None:
    line = bytearray(line_of(frame))
    position = data.draw(st.integers(0, len(line) * 8 - 1))
    line[position // 8] ^= 1 << position % 8
    assert Decoder().feed(bytes(line) + b"\0") == []


def test_longest_frame_fits_and_one_byte_more_is_an_overrun() -> None:
    longest = encode(1, 2, bytes([7]) * MAX_PAYLOAD)
    assert len(longest) == MAX_ENCODED + 1
    decoder = Decoder()
    assert len(decoder.feed(longest)) == 1
    assert decoder.feed(b"\x01" * (MAX_ENCODED + 1)) == []
    assert decoder.overruns == 1
    assert decoder.feed(b"\x01" * 1000) == []
    assert decoder.overruns == 1
    assert len(decoder.feed(b"\0" + longest)) == 1


def test_payload_too_long_is_our_bug() -> None:
    with pytest.raises(BridgeError, match="65 bytes"):
        encode(1, 0, bytes(MAX_PAYLOAD + 1))
