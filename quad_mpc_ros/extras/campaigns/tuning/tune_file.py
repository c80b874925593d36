# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing the files of studies, see ``docs/howto/tune.md``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import ConfigurationError, UserError, ros_yaml
from quad_mpc_ros.extras.campaigns.campaign import Campaign, target_of, value_in
from quad_mpc_ros.extras.campaigns.campaign_file import (
    Overrides,
    campaign_from,
    campaign_text,
    check_keys,
    content_text,
    errors_of,
    integer,
    number,
    read_campaign,
    read_content,
    read_variations,
)
from quad_mpc_ros.extras.campaigns.tuning.objectives import Objective, read_objectives
from quad_mpc_ros.extras.campaigns.tuning.search_space import SearchSpace
from quad_mpc_ros.extras.campaigns.variation import Variation

_KEYS = ("seed", "trials", "give_up", "search", "campaigns", "objectives")
_TRIALS = 100
_DEFAULT_GIVE_UP = 0.25
_MAX_TRIALS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """A study.

    Attributes:
        seed: Seed of the optimiser.
        trials: Number of trials, including the configuration of the campaigns.
        give_up: A trial ends once more than this share of a campaign's flights is lost.
        search: Variations by the names ``mpc.parameter`` or ``mpc.parameter.element``.
        campaigns: Campaigns of each trial, in this order, by name.
        objectives: Objectives to minimise, in order of priority.
    """

    seed: int
    trials: int
    give_up: float
    search: Mapping[str, Variation]
    campaigns: Mapping[str, Campaign]
    objectives: tuple[Objective, ...]

    def space(self) -> SearchSpace:
        """Return the search space."""
        return SearchSpace(self.search, next(iter(self.campaigns.values())))


def read_tuning(path: Path, overrides: Overrides | None = None) -> Tuning:
    """Return the study in a file; ``overrides`` apply to each of its campaigns.

    Raises :class:`UserError` for an unusable file.
    """
    content = read_content(path, "study")
    with errors_of(str(path)):
        return _tuning(content, overrides or Overrides(), path.parent)


def tuning_text(tuning: Tuning) -> str:
    """Return a complete file of a study, which refers to no other file."""
    return content_text({"trials": tuning.trials, **_content(tuning)})


def identity_text(tuning: Tuning) -> str:
    """Return the content that must not change in a study: all except the number of trials."""
    return content_text(_content(tuning))


def _content(tuning: Tuning) -> dict[str, Any]:
    return {
        "seed": tuning.seed,
        "give_up": tuning.give_up,
        "search": {name: each.described() for name, each in tuning.search.items()},
        "campaigns": {
            name: ros_yaml.read(campaign_text(campaign))
            for name, campaign in tuning.campaigns.items()
        },
        "objectives": [objective.described() for objective in tuning.objectives],
    }


def _tuning(content: Mapping[Any, Any], overrides: Overrides, folder: Path) -> Tuning:
    check_keys(content, _KEYS)
    campaigns = {
        str(name): _campaign(str(name), each, overrides, folder)
        for name, each in _mapping(content, "campaigns", "NAME: a campaign or its file").items()
    }
    search = _search(_mapping(content, "search", "mpc.PARAMETER: its variation"), campaigns)
    return Tuning(
        seed=integer("seed", content.get("seed", 0), least=0, most=2**63 - 1),
        trials=integer("trials", content.get("trials", _TRIALS), least=1, most=_MAX_TRIALS),
        give_up=number("give_up", content.get("give_up", _DEFAULT_GIVE_UP), most=1.0),
        search=search,
        campaigns=campaigns,
        objectives=read_objectives(content.get("objectives"), campaigns),
    )


def _campaign(name: str, given: Any, overrides: Overrides, folder: Path) -> Campaign:
    if not name.isidentifier():
        raise ConfigurationError("campaigns", name, "names of letters, digits and _")
    if isinstance(given, str):
        return read_campaign(folder / given, overrides)
    if not isinstance(given, dict):
        raise ConfigurationError(f"campaigns: {name}", given, "a campaign or its file")
    return campaign_from(given, overrides, where=f"campaigns: {name}")


def _search(given: Mapping[Any, Any], campaigns: Mapping[str, Campaign]) -> dict[str, Variation]:
    """Return the variations of parameters that campaigns must set equally and not vary."""
    first, *others = campaigns.values()
    for name in given:
        if not str(name).startswith("mpc."):
            raise UserError(f"search: {name}: expected a parameter of the MPC, mpc.PARAMETER")
    search = read_variations("search", given, {"mpc": first.base["mpc"]})
    parameters = {target.parameter for target in SearchSpace(search, first).targets}
    for parameter in parameters:
        target = target_of(f"mpc.{parameter}", first.base)
        for name, campaign in campaigns.items():
            for varied in campaign.targets.values():
                if (varied.node, varied.parameter) == ("mpc", parameter):
                    raise UserError(f"search: mpc.{parameter}: {name} also varies it: remove one")
        for other in others:
            mine, theirs = (value_in(target, each.base) for each in (first, other))
            if mine != theirs:
                raise UserError(
                    f"search: mpc.{parameter}: the campaigns start with {mine} and {theirs}: "
                    "set the same value in all campaigns"
                )
    return search


def _mapping(content: Mapping[Any, Any], key: str, expected: str) -> dict[Any, Any]:
    given = content.get(key)
    if not isinstance(given, dict) or not given:
        raise ConfigurationError(key, given, expected)
    return given
