# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Campaign files: what they describe, and what is refused in one line."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from fixtures.setup_py import setup_arguments

from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.extras.campaigns.campaign_file import (
    Overrides,
    campaign_from,
    campaign_text,
    located_campaign,
    read_campaign,
)

CONTENT = {
    "flights": 20,
    "seed": 1,
    "config": ["default"],
    "set": {"mpc.horizon_steps": 12},
    "reference": "hover",
    "duration": 2.0,
    "settle_time": 1.0,
    "vary": {
        "simulator.rate_time_constant": {"uniform": [0.02, 0.08]},
        "simulator.thrust_scale": {"uniform": [0.9, 1.1]},
        "simulator.wind": {"uniform": [[-4, -4, -1], [4, 4, 1]]},
        "simulator.seed": {"integers": [0, 1000000]},
        "mpc.R.1": {"log_uniform": [0.001, 1.0]},
        "mpc.R.2": {"same_as": "mpc.R.1"},
        "mpc.rate_time_constant": {
            "same_as": "simulator.rate_time_constant",
            "times": 0.5,
            "plus": 0.01,
        },
    },
}


def changed(**values):
    return {**CONTENT, **values}


def varied(**variations):
    return changed(vary={name.replace("__", "."): said for name, said in variations.items()})


def test_file_defines_the_flights():
    campaign = campaign_from(CONTENT)
    drawn = campaign.drawn(7)
    mpc, simulator, reference = campaign.plan(7).config
    assert campaign.flights == 20
    assert mpc.horizon_steps == 12
    assert mpc.lockstep
    assert (reference.trajectory, simulator.duration) == ("hover", 2.0)
    assert 0.02 <= simulator.rate_time_constant <= 0.08
    assert simulator.rate_time_constant == drawn["simulator.rate_time_constant"]
    assert mpc.rate_time_constant == 0.5 * simulator.rate_time_constant + 0.01
    assert mpc.R[1] == mpc.R[2] == drawn["mpc.R.1"] != mpc.R[3]
    assert list(simulator.wind) == drawn["simulator.wind"]


def test_flights_do_not_depend_on_count_or_other_variations():
    one = campaign_from(CONTENT)
    vary = {name: CONTENT["vary"][name] for name in reversed(CONTENT["vary"])}
    other = campaign_from(
        changed(flights=5, vary={"simulator.mass_scale": {"uniform": [0.9, 1.1]}, **vary})
    )
    for number in range(5):
        drawn = other.drawn(number)
        assert drawn.pop("simulator.mass_scale") not in one.drawn(number).values()
        assert drawn == one.drawn(number)
    assert one.drawn(0) != one.drawn(1)
    assert one.drawn(0) != campaign_from(changed(seed=2)).drawn(0)


def test_written_campaign_file_is_complete(tmp_path):
    parameters = tmp_path / "own.yaml"
    parameters.write_text("mpc: {ros__parameters: {mass: 0.5, Q: [1, 1, 1, 1, 1, 1, 1, 1, 1]}}")
    campaign = campaign_from(changed(config=["paper", str(parameters)]))
    parameters.unlink()
    again = campaign_from(yaml.safe_load(campaign_text(campaign)))
    assert campaign_text(again) == campaign_text(campaign)
    assert again.plan(3).config == campaign.plan(3).config
    assert again.plan(3).config.mpc.mass == 0.5


def test_smooth_references_begin_in_motion_except_for_given_start_values():
    content = changed(reference="circle", vary={}, set={"simulator.initial_throttle": 0.5})
    simulator = campaign_from(content).plan(0).config.simulator
    assert np.linalg.norm(simulator.initial_velocity) > 0.5
    assert simulator.initial_throttle == 0.5
    grounded = campaign_from({**content, "start": "ground"}).plan(0).config.simulator
    assert grounded.initial_velocity == (0.0, 0.0, 0.0)
    placed = {"simulator.initial_position": {"uniform": [[0, 0, 1], [1, 1, 2]]}}
    simulator = campaign_from({**content, "vary": placed}).plan(0).config.simulator
    assert 1.0 <= simulator.initial_position[2] <= 2.0
    assert np.linalg.norm(simulator.initial_velocity) > 0.5


def test_command_line_overrides_the_file():
    overrides = Overrides(config=["paper"], assignments=["mpc.mass=0.5"], flights=3, seed=9)
    campaign = campaign_from(CONTENT, overrides)
    assert (campaign.flights, campaign.seed) == (3, 9)
    assert campaign.base["mpc"].formulation == "paper"
    assert campaign.base["mpc"].mass == 0.5
    assert campaign.base["reference"].trajectory == "square"  # the preset says so


MISTAKES = {
    "key": (changed(flihgts=3), "unknown key 'flihgts' (did you mean flights?)"),
    "no flights": ({"vary": {}}, "flights: given None, expected a whole number from 1"),
    "seed": (changed(seed=-1), "seed: given -1"),
    "unknown parameter": (
        varied(simulator__winf={"uniform": [0, 1]}),
        "simulator.winf: given None, expected a known parameter (did you mean wind?)",
    ),
    "unknown node": (varied(recorder__x={"uniform": [0, 1]}), "expected one of mpc.PARAMETER"),
    "range": (
        varied(simulator__rate_time_constant={"uniform": [-0.1, 0.1]}),
        "simulator.rate_time_constant: given -0.1, expected a number >= 0",
    ),
    "length": (
        varied(simulator__wind={"uniform": [[0, 0], [1, 1]]}),
        "simulator.wind: given [0.0, 0.0], expected 3 numbers",
    ),
    "empty choice": (
        {"flights": 1, "vary": {"reference.trajectory": {"choice": []}}},
        "vary: reference.trajectory: choice: given [], expected a list of at least one value",
    ),
    "set, too": (
        varied(mpc__horizon_steps={"integers": [5, 20]}),
        "vary: mpc.horizon_steps: also set: remove one of them",
    ),
    "reference, too": (
        varied(reference__trajectory={"choice": ["square"]}),
        "vary: reference.trajectory: also set as reference",
    ),
    "duration, too": (
        changed(set={"simulator.duration": 3.0}),
        "duration: also set as simulator.duration",
    ),
    "whole and element": (
        changed(
            vary={"simulator.wind": {"uniform": [[0] * 3, [1] * 3]}}
            | {"simulator.wind.0": {"uniform": [0, 1]}}
        ),
        "vary: simulator.wind.0: simulator.wind is also varied",
    ),
    "circle": (
        varied(mpc__mass={"same_as": "mpc.gravity"}, mpc__gravity={"same_as": "mpc.mass"}),
        "circular reference",
    ),
    "follows nothing": (varied(mpc__mass={"same_as": "mpc.masss"}), "did you mean mass?"),
    "follows too far": (
        varied(
            simulator__rate_time_constant={"uniform": [0.0, 0.1]},
            mpc__rate_time_constant={"same_as": "simulator.rate_time_constant", "plus": -0.05},
        ),
        "mpc.rate_time_constant: given -0.05",
    ),
    "settle time": (changed(settle_time=2.0), "settle_time: given 2.0, expected a number >= 0"),
    "start": (changed(start="air"), "start: given 'air', expected one of auto, ground, reference"),
    "set": (changed(set={"mas": 1}), "set: mas: expected one of mpc.PARAMETER"),
    "set value": (changed(set={"mpc.mass": -1}), "mpc.mass: given -1, expected a number > 0"),
    "vary": (changed(vary=["mpc.mass"]), "vary: given ['mpc.mass'], expected parameters"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_reported_in_one_line_with_the_file(mistake, tmp_path: Path):
    content, message = MISTAKES[mistake]
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(UserError) as raised:
        read_campaign(path)
    assert message in str(raised.value)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("text", ["- 1", "{", "a: b: c", "\x00"])
def test_refuses_a_file_without_keys(text, tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=r"campaign\.yaml"):
        read_campaign(path)
    with pytest.raises(UserError, match="cannot be read"):
        read_campaign(tmp_path / "none.yaml")


def test_shipped_campaigns_are_found_by_name_and_installed(tmp_path: Path) -> None:
    shipped = files.shipped("campaigns")
    campaigns = shipped.keys() - {"tune_vehicles"}
    assert {"hover", "lemniscate", "delay", "quick"} <= campaigns
    for name in campaigns:
        assert read_campaign(located_campaign(Path(name))).flights >= 1
    installed = dict(setup_arguments()["data_files"])["share/quad_mpc_ros/config/campaigns"]
    assert {Path(each).stem for each in installed} == shipped.keys()
    own = tmp_path / "hover"
    own.write_text("flights: 1")
    assert located_campaign(own) == own
    with pytest.raises(UserError, match=r"hoover.*hover, lemniscate"):
        located_campaign(Path("hoover"))
