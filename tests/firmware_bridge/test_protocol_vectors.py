"""PROTOCOL.md is the reference: its hex is what the code must produce and understand."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

import firmware_bridge
from firmware_bridge import messages
from firmware_bridge.framing import Decoder, crc16

DOCUMENT = Path(firmware_bridge.__file__).with_name("PROTOCOL.md").read_text(encoding="utf-8")


def rows(header: str) -> list[list[str]]:
    """Cells of the Markdown table that begins with `header`."""
    lines = DOCUMENT[DOCUMENT.index(header) :].splitlines()[2:]
    table = lines[: next((i for i, line in enumerate(lines) if not line.startswith("|")), len(lines))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def value(text: str) -> int | bytes:
    return text.encode().ljust(16, b"\0") if text[0].isalpha() else int(text, 0)


def message_of(name: str, text: str) -> messages.Message:
    given = dict(field.split("=") for field in text.split())
    return getattr(messages, name)(**{key: value(given[key]) for key in given})


GOOD = rows("| message | seq | fields | frame |")
BAD = rows("| why | counter | frame |")


def test_every_message_has_a_vector() -> None:
    assert {name for name, *_ in GOOD} == {kind.__name__ for kind in messages._TYPES.values()}
    assert len(BAD) == 7


@pytest.mark.parametrize(("name", "seq", "text", "frame"), GOOD)
def test_encodes_as_documented(name: str, seq: str, text: str, frame: str) -> None:
    message = message_of(name, text)
    assert messages.to_bytes(message, int(seq)).hex(" ") == frame.strip("`")
    assert len(text.split()) == len(fields(message))


@pytest.mark.parametrize(("name", "seq", "text", "frame"), GOOD)
def test_decodes_as_documented(name: str, seq: str, text: str, frame: str) -> None:
    (decoded,) = Decoder().feed(bytes.fromhex(frame.strip("`")))
    assert decoded.seq == int(seq)
    assert messages.parse(decoded) == message_of(name, text)


@pytest.mark.parametrize(("why", "counter", "frame"), BAD)
def test_drops_as_documented(why: str, counter: str, frame: str) -> None:
    decoder = Decoder()
    found = decoder.feed(bytes.fromhex(frame.strip("`")))
    if counter == "parse":
        with pytest.raises(messages.MalformedMessage):
            messages.parse(found[0])
    else:
        assert found == [] and getattr(decoder, counter) == 1, why


def test_sizes_and_types_in_the_table_of_messages() -> None:
    table = rows("| type | name | from | payload | bytes |")
    by_code = {int(code, 16): (name, int(size)) for code, name, _, _, size in table}
    assert {code: kind.LAYOUT.size for code, kind in messages._TYPES.items()} == {
        code: size for code, (_, size) in by_code.items()
    }
    for code, kind in messages._TYPES.items():
        assert by_code[code][0].replace("_", "") == kind.__name__.upper()


def test_crc_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1
