"""Responses, buckets, links and routes on maps small enough to work out on paper."""

from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.thesis.links import Links, similar_pairs, similarity_threshold, similarity_variance
from omnibotd.core.thesis.responses import Buckets, Classifier, pack, unpack
from omnibotd.core.thesis.route import Route
from tests.core.thesis.maps import ODOMETRY, SIMILARITY, chain, made_map


def test_a_response_is_the_distance_to_each_unit() -> None:
    codebook = np.array([[0.0, 0.0], [3.0, 4.0]], np.float32)
    assert Classifier(codebook)([0.0, 0.0]) == pytest.approx([0.0, 5.0])
    assert Classifier(codebook)([3.0, 0.0]) == pytest.approx([3.0, 4.0])


def test_responses_keep_all_their_bits_in_a_map() -> None:
    responses = np.random.default_rng(1).normal(900.0, 50.0, (3, 4)).astype(np.float32)
    topo_map = made_map([(0, 0, 0)] * 3, [(0, 1, ODOMETRY)], responses)
    assert topo_map.snapshots.shape == (3, 16)
    assert pack(unpack(topo_map)).tobytes() == responses.astype("<f4").tobytes()


def test_a_map_of_another_method_is_refused() -> None:
    topo_map = chain([(0, 0), (1, 0)])
    with pytest.raises(MapError, match="'default'"):
        unpack(replace(topo_map, method="default"))
    with pytest.raises(MapError, match="12 bytes"):
        unpack(replace(topo_map, snapshots=topo_map.snapshots[:, :12]))
    with pytest.raises(MapError, match="similarity_threshold"):
        Links.of(replace(topo_map, statistics={}))


def test_an_empty_bucket_widens_ring_by_ring_over_the_edge_of_the_torus() -> None:
    units = np.array([0, 0, 12, 4])  # of 5 x 5: unit 4 is beside unit 0 over the edge, unit 12 in the middle
    buckets = Buckets(units, 5)
    assert buckets.near(0).tolist() == [0, 1]
    assert buckets.near(24).tolist() == [0, 1, 3]  # row 4, column 4: both corners touch it
    assert buckets.near(7).tolist() == [2]  # row 1, column 2: the middle is below it
    with pytest.raises(MapError, match="no node"):
        Buckets(np.array([], int), 5)


def test_sub_nodes_are_linked_when_alike_and_not_driven_in_succession() -> None:
    responses = np.array([[1.0, 9], [1.5, 9], [1.0, 9], [5.0, 9], [9, 1.0], [9, 1.2]], np.float32)
    units = np.array([0, 0, 0, 0, 1, 1])
    assert similar_pairs(responses, units, 1.0).tolist() == [[0, 2]]
    assert similar_pairs(responses, units, 5.0).tolist() == [[0, 2], [0, 3], [1, 3]]
    # Steps of 0.5, 0.5, 4.0, sqrt(16 + 64) and 0.2: the middle one is 0.5.
    assert similarity_threshold(responses) == pytest.approx(0.5)


def test_variances_are_those_of_reading_a() -> None:
    responses = np.array([[1.0, 9, 9, 9], [9, 1.0, 9, 9], [4.0, 9, 9, 9]])
    links = [(0, 1, ODOMETRY), (1, 2, ODOMETRY), (0, 2, SIMILARITY)]
    found = Links.of(made_map([(0, 0, 0), (3, 4, 1), (3, 4.5, 2)], links, responses, threshold=6.0))
    assert found.offsets.tolist() == [[3.0, 4.0], [0.0, 0.5], [0.0, 0.0]]
    assert found.variances == pytest.approx([0.02 * 5.0, 0.02 * 0.5, 0.05 * 3.0 / 6.0])
    assert similarity_variance(60.0, 6.0) == pytest.approx(0.05)


def test_a_route_sums_offsets_and_variances_both_ways() -> None:
    topo_map = chain([(0, 0), (1, 0), (1, 2), (0, 2)])
    route = Route(Links.of(topo_map), 4, 2)
    for node, z, metres in ((0, (1.0, 2.0), 3.0), (1, (0.0, 2.0), 2.0), (2, (0.0, 0.0), 0.0), (3, (1.0, 0.0), 1.0)):
        measured = route.measurement(node)
        assert measured is not None
        assert measured[0] == pytest.approx(z)
        assert measured[1] == pytest.approx(0.02 * metres)


def test_a_route_prefers_the_surer_way_and_takes_similarity_for_the_same_place() -> None:
    """A drive of 8 m that comes back: by odometry it ended 0.4 m off, the look-alike link says it is where it began."""
    poses = [(0, 0, 0), (4, 0, 0), (0.4, 0, 0), (0.4, 1, 0)]
    responses = np.array([[1.0, 9, 9, 9], [9, 1.0, 9, 9], [3.0, 9, 9, 9], [9, 9, 1.0, 9]])
    links = [(0, 1, ODOMETRY), (1, 2, ODOMETRY), (2, 3, ODOMETRY), (0, 2, SIMILARITY)]
    measured = Route(Links.of(made_map(poses, links, responses, threshold=4.0)), 4, 3).measurement(0)
    assert measured is not None
    assert measured[0] == pytest.approx([0.0, 1.0])
    assert measured[1] == pytest.approx(0.05 * 2.0 / 4.0 + 0.02)


def test_no_route_leads_between_parts_that_no_link_joins() -> None:
    topo_map = made_map([(0, 0, 0), (1, 0, 0), (5, 5, 0)], [(0, 1, ODOMETRY)])
    assert Route(Links.of(topo_map), 3, 0).measurement(2) is None
