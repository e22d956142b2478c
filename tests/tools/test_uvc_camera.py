"""The simulated webcam and its cable, against a peer that plays QEMU's part of the usb-redir protocol."""

import struct

import pytest

from tools.sim.usb_redir import RedirError, RedirSession
from tools.sim.uvc_camera import UvcCamera

JPEG = bytes(range(256)) * 100
HELLO, CONNECT, DISCONNECT, SET_CONFIGURATION, STATUS, CANCEL, CONTROL, BULK = 0, 1, 2, 6, 8, 21, 100, 101
ALL_CAPABILITIES = 0xFF
STREAM = 0x81


class Host:
    """Sends what QEMU would, and takes the answers apart."""

    def __init__(self, capabilities: int = ALL_CAPABILITIES) -> None:
        self.camera = UvcCamera(640, 480)
        self.camera.session = self.session = RedirSession(self.camera)
        self._wide = False
        self._number = 0
        assert [kind for kind, _, _ in self.heard()] == [HELLO]
        self.send(HELLO, b"qemu".ljust(64, b"\0") + struct.pack("<I", capabilities))
        self._wide = True

    def send(self, kind: int, body: bytes = b"", number: int | None = None) -> int:
        self._number += 1
        number = self._number if number is None else number
        layout = "<IIQ" if self._wide else "<III"
        packet = struct.pack(layout, kind, len(body), number) + body
        for at in range(0, len(packet), 7):  # as the socket may cut it
            self.session.receive(packet[at : at + 7])
        self.camera.pump()
        return number

    def heard(self) -> list[tuple[int, int, bytes]]:
        """(kind, number, body) of each packet since the last call."""
        data, packets = self.session.data_to_send(), []
        while data:
            wide = self._wide and data[:4] != bytes(4)
            size = 16 if wide else 12
            kind, length, number = struct.unpack_from("<IIQ" if wide else "<III", data)
            packets.append((kind, number, data[size : size + length]))
            data = data[size + length :]
        return packets

    def control(self, kind: int, request: int, value: int, index: int, length: int, data: bytes = b"") -> bytes | None:
        """The answer, None for a stall."""
        self.heard()
        self.send(CONTROL, struct.pack("<BBBBHHH", kind & 0x80, request, kind, 0, value, index, length) + data)
        ((_, _, body),) = self.heard()
        status = body[3]
        assert struct.unpack_from("<H", body, 8)[0] == (length if not kind & 0x80 else len(body) - 10)
        return None if status else body[10:]

    def ask_for_pictures(self, room: int, transfers: int) -> list[int]:
        body = struct.pack("<BBHIH", STREAM, 0, room & 0xFFFF, 0, room >> 16)
        return [self.send(BULK, body) for _ in range(transfers)]

    def answers(self) -> list[tuple[int, int, bytes]]:
        """(number, status, data) of the bulk transfers that are done."""
        found = []
        for kind, number, body in self.heard():
            assert kind == BULK
            low, _, high = struct.unpack_from("<HIH", body, 2)
            assert len(body) - 10 == high << 16 | low
            found.append((number, body[1], body[10:]))
        return found


@pytest.fixture
def host() -> Host:
    return Host()


def descriptors(data: bytes) -> list[bytes]:
    found = []
    while data:
        found.append(data[: data[0]])
        assert len(found[-1]) == data[0] >= 2
        data = data[data[0] :]
    return found


def test_it_says_who_it_is_when_plugged_in(host):
    connect = next(body for kind, _, body in host.heard() if kind == CONNECT)
    speed, usb_class, _, _, vendor, product, _ = struct.unpack("<BBBBHHH", connect)
    assert (speed, usb_class, vendor, product) == (2, 0xEF, 0x1D6B, 0x0102)
    device = host.control(0x80, 6, 0x0100, 0, 18)
    assert device is not None and len(device) == 18
    assert struct.unpack_from("<HH", device, 8) == (vendor, product)


def test_its_descriptors_add_up(host):
    whole = host.control(0x80, 6, 0x0200, 0, 4096)
    assert whole is not None
    assert struct.unpack_from("<H", whole, 2)[0] == len(whole)
    assert host.control(0x80, 6, 0x0200, 0, 9) == whole[:9]
    parts = descriptors(whole)
    # The totals of both headers of the video class cover what follows them up to the next standard descriptor.
    for subtype, kind in ((1, 0x24),):
        headers = [i for i, part in enumerate(parts) if part[1] == kind and part[2] == subtype]
        assert len(headers) == 2
        for at in headers:
            offset = 5 if parts[at][0] == 13 else 4
            (total,) = struct.unpack_from("<H", parts[at], offset)
            block = [part for part in parts[at:] if part[1] == 0x24]
            length = 0
            for part in parts[at:]:
                if part[1] != 0x24:
                    break
                length += len(part)
            assert block and total == length
    (frame,) = [part for part in parts if part[1:3] == b"\x24\x07"]
    assert struct.unpack_from("<HH", frame, 5) == (640, 480)
    assert frame[25] == 3 and len(frame) == 26 + 4 * 3


def test_it_has_a_name(host):
    assert host.control(0x80, 6, 0x0300, 0, 255) == b"\x04\x03\x09\x04"
    name = host.control(0x80, 6, 0x0302, 0x0409, 255)
    assert name is not None and name[2:].decode("utf-16le") == "Simulated ceiling camera"
    assert host.control(0x80, 6, 0x0309, 0x0409, 255) is None


@pytest.mark.parametrize(("asked", "given"), [(1_000_000, 1_000_000), (333_333, 666_666), (9_000_000, 2_000_000)])
def test_the_rate_is_the_nearest_that_it_has(host, asked, given):
    wish = struct.pack("<HBBI", 1, 1, 1, asked).ljust(26, b"\0")
    assert host.control(0x21, 0x01, 0x0100, 1, 26, wish) == b""
    settings = host.control(0xA1, 0x81, 0x0100, 1, 26)
    assert settings is not None and len(settings) == 26
    assert struct.unpack_from("<I", settings, 4)[0] == given


def test_a_picture_comes_whole_through_transfers_of_any_size(host):
    host.heard()
    numbers = host.ask_for_pictures(10_000, 5)
    assert host.answers() == []
    host.camera.show(JPEG)
    answers = host.answers()
    assert [number for number, _, _ in answers] == numbers[:3]
    data = b"".join(part for _, _, part in answers)
    assert (data[0], data[2:]) == (2, JPEG)
    assert [len(part) for _, _, part in answers] == [10_000, 10_000, len(JPEG) + 2 - 20_000]


def test_a_picture_that_fills_its_transfers_ends_with_an_empty_one(host):
    host.heard()
    host.ask_for_pictures((len(JPEG) + 2) // 2, 3)
    host.camera.show(JPEG)
    assert [len(part) for _, _, part in host.answers()] == [(len(JPEG) + 2) // 2] * 2 + [0]


def test_pictures_take_turns_in_their_mark_and_are_not_queued(host):
    host.heard()
    host.ask_for_pictures(50_000, 1)
    for _ in range(3):
        host.camera.show(JPEG)
    host.ask_for_pictures(50_000, 1)
    host.camera.show(JPEG)
    marks = [data[1] & 1 for _, _, data in host.answers()]
    assert marks == [0, 1]
    assert host.camera.frames == 2


def test_a_frozen_camera_says_nothing_and_stays(host):
    host.heard()
    host.ask_for_pictures(50_000, 2)
    host.camera.frozen = True
    host.camera.show(JPEG)
    assert host.answers() == []
    assert host.control(0x80, 6, 0x0100, 0, 18) is not None
    host.camera.frozen = False
    host.camera.show(JPEG)
    assert len(host.answers()) == 1


def test_a_transfer_taken_back_is_given_back_empty(host):
    host.heard()
    first, second = host.ask_for_pictures(50_000, 2)
    host.send(CANCEL, number=first)
    assert host.answers() == [(first, 1, b"")]
    host.camera.show(JPEG)
    assert [number for number, _, _ in host.answers()] == [second]


def test_a_configuration_forgets_what_was_under_way(host):
    host.heard()
    host.ask_for_pictures(100, 1)
    host.camera.show(JPEG)
    host.send(SET_CONFIGURATION, b"\x01")
    assert (STATUS, b"\x00\x01") in [(kind, body) for kind, _, body in host.heard()]
    host.ask_for_pictures(50_000, 1)
    assert host.answers() == []
    host.camera.show(JPEG)
    ((_, _, data),) = host.answers()
    assert data[2:] == JPEG


def test_unplugged_it_says_so(host):
    host.heard()
    host.session.unplug()
    assert [(kind, body) for kind, _, body in host.heard()] == [(DISCONNECT, b"")]


def test_a_peer_that_can_not_do_what_is_needed_is_refused():
    with pytest.raises(RedirError, match="lacks abilities"):
        Host(capabilities=0x02)


def test_nothing_is_understood_before_the_hello():
    session = RedirSession(UvcCamera(640, 480))
    with pytest.raises(RedirError, match="before the hello"):
        session.receive(struct.pack("<III", SET_CONFIGURATION, 1, 1) + b"\x01")
