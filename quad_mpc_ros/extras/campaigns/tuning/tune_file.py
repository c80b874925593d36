# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing the files of studies, see ``docs/howto/tune.md``."""

from __future__ import annotations

import dataclasses
import functools
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
from quad_mpc_ros.extras.campaigns.variation import (
    Choice,
    Integers,
    SameAs,
    Uniform,
    Variation,
)

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

    @functools.cached_property
    def _searched(self) -> Campaign:
        """A campaign that varies the searched parameters."""
        return dataclasses.replace(next(iter(self.campaigns.values())), vary=self.search)

    def base_values(self) -> dict[str, Any]:
        """Return the values of the searched parameters in the campaigns."""
        base = self._searched.base
        return {name: value_in(target_of(name, base), base) for name in self.search}

    def values_at(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all searched parameters, given those that follow no other."""
        return self._searched.completed(point)

    def parameters(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the searched parameters of the controller, with whole vectors, by name.

        Raises :class:`ConfigurationError` for values that cannot be used together.
        """
        every = self._searched.configured(values).mpc.flattened()
        names = dict.fromkeys(target.parameter for target in self._searched.targets.values())
        return {name: every[name] for name in names}

    def configured(self, values: Mapping[str, Any]) -> dict[str, Campaign]:
        """Return the campaigns with searched values.

        Raises :class:`UserError` or ``ValueError`` for values that cannot be used together.
        """
        parameters, changed = self.parameters(values), {}
        for name, campaign in self.campaigns.items():
            given = {**campaign.given, "mpc": {**campaign.given["mpc"], **parameters}}
            changed[name] = dataclasses.replace(campaign, given=given)
            changed[name].configured(changed[name].drawn(0))
        return changed

    def identity_text(self) -> str:
        """Return the content that must not change in a study: all except the trials."""
        content = {
            "seed": self.seed,
            "give_up": self.give_up,
            "search": {name: each.described() for name, each in self.search.items()},
            "campaigns": {
                name: ros_yaml.read(campaign_text(campaign))
                for name, campaign in self.campaigns.items()
            },
            "objectives": [vars(objective) for objective in self.objectives],
        }
        return content_text(content)

    def text(self) -> str:
        """Return a complete file of the study, which refers to no other file."""
        return f"trials: {self.trials}\n{self.identity_text()}"


def read_tuning(path: Path, overrides: Overrides | None = None) -> Tuning:
    """Return the study in a file; ``overrides`` apply to each of its campaigns.

    Raises :class:`UserError` for an unusable file.
    """
    content = read_content(path, "study")
    with errors_of(str(path)):
        return _tuning(content, overrides or Overrides(), path.parent)


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
    for name, variation in search.items():
        if not isinstance(variation, Uniform | Integers | Choice | SameAs):
            expected = "uniform, log_uniform, integers, choice or same_as"
            raise UserError(f"search: {name}: expected {expected}")
        if any(isinstance(value, list) for value in variation.extremes()):
            raise UserError(f"search: {name}: given a vector: search {name}.0, {name}.1, …")
        target = target_of(name, first.base)
        for other, campaign in campaigns.items():
            varied = [each.parameter for each in campaign.targets.values() if each.node == "mpc"]
            if target.parameter in varied:
                raise UserError(f"search: {name}: {other} also varies it: remove one")
        for campaign in others:
            mine, theirs = (value_in(target, each.base) for each in (first, campaign))
            if mine != theirs:
                raise UserError(
                    f"search: {name}: the campaigns start with {mine} and {theirs}: set the same "
                    "value in all campaigns"
                )
    return search


def _mapping(content: Mapping[Any, Any], key: str, expected: str) -> dict[Any, Any]:
    given = content.get(key)
    if not isinstance(given, dict) or not given:
        raise ConfigurationError(key, given, expected)
    return given
