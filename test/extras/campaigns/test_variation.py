# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How parameters vary: the distributions are those they are called, and nothing else varies."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.extras.campaigns.variation import variation_of

DISTRIBUTIONS = {
    "uniform": ({"uniform": [2.0, 5.0]}, stats.uniform(2.0, 3.0)),
    "log_uniform": ({"log_uniform": [0.001, 10.0]}, stats.loguniform(0.001, 10.0)),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_numbers_have_the_given_distribution(name):
    said, expected = DISTRIBUTIONS[name]
    variation = variation_of("x", said)
    random = np.random.default_rng(1)
    drawn = [variation.drawn(random) for _ in range(2000)]
    assert stats.kstest(drawn, expected.cdf).pvalue > 0.01


def test_elements_of_a_vector_vary_independently():
    variation = variation_of("x", {"uniform": [[-4, -4, -1], [4, 4, 1]]})
    random = np.random.default_rng(1)
    drawn = np.array([variation.drawn(random) for _ in range(2000)])
    assert np.all(np.abs(drawn) <= [4.0, 4.0, 1.0])
    assert np.all(np.ptp(drawn, axis=0) > [7.8, 7.8, 1.9])
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.1


def test_both_ends_of_integers_occur():
    variation = variation_of("x", {"integers": [3, 5]})
    random = np.random.default_rng(1)
    assert {variation.drawn(random) for _ in range(200)} == {3, 4, 5}


def test_attitudes_fill_the_tilt_cone_and_yaw_range():
    tilt, yaw = 0.5, 1.0
    variation = variation_of("x", {"attitude": [tilt, yaw]})
    random = np.random.default_rng(1)
    drawn = Rotation.from_quat([variation.drawn(random) for _ in range(2000)])
    up = drawn.apply([0.0, 0.0, 1.0])
    heights, directions = up[:, 2], np.arctan2(up[:, 1], up[:, 0])
    cap = stats.uniform(np.cos(tilt), 1.0 - np.cos(tilt))  # Archimedes: areas are heights
    assert stats.kstest(heights, cap.cdf).pvalue > 0.01
    assert stats.kstest(directions, stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 0.01
    # What is left once the shortest turn of the thrust is undone.
    level = [Rotation.align_vectors([[0.0, 0.0, 1.0]], [z])[0] for z in up]
    turns = np.array(
        [(back * each).as_rotvec()[2] for back, each in zip(level, drawn, strict=True)]
    )
    assert stats.kstest(turns, stats.uniform(-yaw, 2.0 * yaw).cdf).pvalue > 0.01


def test_choices_occur_equally_often():
    variation = variation_of("x", {"choice": ["square", "hover", [1, 2]]})
    random = np.random.default_rng(1)
    drawn = [str(variation.drawn(random)) for _ in range(3000)]
    counts = np.unique(drawn, return_counts=True)[1]
    assert stats.chisquare(counts).pvalue > 0.01


def test_same_as_follows_another_parameter():
    variation = variation_of("x", {"same_as": "y", "times": 2.0, "plus": 0.5})
    assert variation.of(1.0) == 2.5
    assert variation.of([1.0, 2.0]) == [2.5, 4.5]
    assert variation_of("x", {"same_as": "y"}).of("hover") == "hover"


@pytest.mark.parametrize(
    "said",
    [
        *({}, None, 3.0, [1, 2], {"uniform": [0, 1], "choice": [0, 1]}, {"unifrom": [0, 1]}),
        *({"uniform": [1]}, {"uniform": [1, 0]}, {"uniform": ["a", "b"]}, {"uniform": [0, 1, 2]}),
        *({"uniform": [[0, 0], [1, 1, 1]]}, {"uniform": [0, [1, 1]]}, {"uniform": [0, True]}),
        *({"log_uniform": [0.0, 1.0]}, {"attitude": [4.0, 0.0]}, {"attitude": [0.1]}),
        *({"integers": [1.5, 2]}, {"integers": [2, 1]}, {"choice": []}, {"choice": "ab"}),
        *({"same_as": 3}, {"same_as": "y", "minus": 1}, {"same_as": "y", "times": "b"}),
        *({"uniform": [0, float("nan")]}, {"uniform": [0, float("inf")]}),
    ],
)
def test_refuses_an_invalid_variation(said):
    with pytest.raises(ConfigurationError, match="x"):
        variation_of("x", said)


@pytest.mark.parametrize(
    "said",
    [
        *({"uniform": [0.0, 1.0]}, {"uniform": [[0.0, 0.0], [1.0, 2.0]]}),
        *({"log_uniform": [0.1, 1.0]}, {"attitude": [0.3, 1.0]}, {"integers": [0, 5]}),
        *({"choice": ["a", 2, [1.0]]}, {"same_as": "y", "times": 2.0, "plus": 0.0}),
    ],
)
def test_description_reads_back_as_the_same_variation(said):
    assert variation_of("x", said).described() == said
