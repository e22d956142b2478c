from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.map_canvas import LONG_SIDE
from omnibotd.map_plot import FLOOR_RADIUS, NODE, PLACE, ROBOT, Path, plot_png, plot_svg


def line_map(length: float) -> TopoMap:
    """Nodes every 10 cm along x."""
    count = max(2, round(length / 0.1))
    poses = np.zeros((count, 3), np.float32)
    poses[:, 0] = np.arange(count) * 0.1
    first = np.arange(count - 1, dtype=np.int32)
    edges = Edges(first, first + 1, np.full(count - 1, EdgeKind.ODOMETRY, np.uint8))
    units, snapshots = np.zeros(count, np.uint16), np.zeros((count, 512), np.uint8)
    return TopoMap("line", np.zeros((1, 192), np.float32), units, snapshots, poses, units, edges)


def picture(png: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def columns(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Columns of the map's part of the image in which the colour occurs."""
    return np.flatnonzero((image[60:, :930] == colour).all(axis=2).any(axis=0))


@pytest.mark.parametrize("length", [0.2, 3.0, 40.0])
def test_rooms_of_any_size_make_a_picture_of_bounded_size(length: float) -> None:
    image = picture(plot_png(line_map(length)))
    assert max(image.shape) < 1500
    assert len(columns(image, NODE)) > 0


def test_places_and_robot_stand_where_they_are() -> None:
    topo_map = line_map(4.0).with_place("end", Pose2D(3.9, 0.0, 1.57))
    image = picture(plot_png(topo_map, Pose2D(0.0, 0.0, -1.57), [Path([(0.0, 0.4), (1.0, 0.4)], (1, 2, 3), "way")]))
    nodes, place, robot = (columns(image, colour) for colour in (NODE, PLACE, ROBOT))
    assert abs(int(np.median(robot)) - nodes.min()) < 25
    assert abs(int(np.median(place)) - nodes.max()) < 60  # its name stands to the right
    width = 3.9 + 4 * FLOOR_RADIUS  # m: the nodes, and twice the floor beside them on either side
    assert len(columns(image, (1, 2, 3))) == pytest.approx(LONG_SIDE / width, abs=5)


def test_the_same_picture_as_shapes() -> None:
    topo_map = line_map(4.0).with_place("a<b&c", Pose2D(3.9, 0.0, 1.57))
    svg = ElementTree.fromstring(plot_svg(topo_map, Pose2D(), [Path([(0.0, 0.4), (1.0, 0.4)], (1, 2, 3), "way")]))
    texts = {element.text for element in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {"a<b&c", "way", "robot", "dock"} & texts == {"a<b&c", "way", "robot"}
    ways = [element.get("d", "") for element in svg.iter("{http://www.w3.org/2000/svg}path")]
    links = [way for way in ways if way.count("L") == 39]
    assert len(links) == 1  # all of one kind are one shape
    assert sum(way.count("h0") for way in ways) == 2 * 40 + 1  # floor and node of each, and the place
    height = int(svg.get("height", "0"))
    assert int(svg.get("width", "0")) < 1500
    assert 0 < height < 1500
