"""Reading and writing the files of studies, see ``docs/howto/tune.md``."""

from __future__ import annotations

import math
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
    read_campaign,
    read_variations,
)
from quad_mpc_ros.extras.campaigns.tuning.objectives import Objective, read_objectives
from quad_mpc_ros.extras.campaigns.tuning.search_space import SearchSpace
from quad_mpc_ros.extras.campaigns.variation import Variation
from quad_mpc_ros.extras.campaigns.yaml_content import (
    check_keys,
    content_text,
    errors_of,
    integer,
    read_content,
)

_KEYS = ("seed", "trials", "timeout", "give_up", "search", "campaigns", "objectives")
_TRIALS = 100
_DEFAULT_GIVE_UP = 0.25
_MAX_TRIALS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """What is tuned, and how.

    Attributes:
        seed: From which the optimiser draws.
        trials: How many configurations are tried, the campaigns' own among them.
        timeout: After so much work no trial begins [s]; infinite for never.
        give_up: A trial ends as soon as more than this share of a campaign's flights is lost.
        search: What may change, by names ``mpc.parameter`` or ``mpc.parameter.element``.
        campaigns: What each trial flies, in this order, by name.
        objectives: What is minimised.
    """

    seed: int
    trials: int
    timeout: float
    give_up: float
    search: Mapping[str, Variation]
    campaigns: Mapping[str, Campaign]
    objectives: tuple[Objective, ...]

    def space(self) -> SearchSpace:
        """Return the space of what may change."""
        return SearchSpace(self.search, next(iter(self.campaigns.values())))


def read_tuning(path: Path, overrides: Overrides | None = None) -> Tuning:
    """Return what a file describes; ``overrides`` hold for each of its campaigns.

    Raises :class:`UserError` for a file that cannot be read or describes no study.
    """
    content = read_content(path, "study")
    with errors_of(str(path)):
        return _tuning(content, overrides or Overrides(), path.parent)


def tuning_text(tuning: Tuning) -> str:
    """Return a file that describes a study wholly: it names no other file."""
    limits: dict[str, Any] = {"trials": tuning.trials}
    if math.isfinite(tuning.timeout):
        limits |= {"timeout": tuning.timeout}
    return content_text({**limits, **_content(tuning)})


def identity_text(tuning: Tuning) -> str:
    """Return what may not change during a study: all but its length."""
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
    search = _search(_mapping(content, "search", "mpc.PARAMETER: how it varies"), campaigns)
    return Tuning(
        seed=integer("seed", content.get("seed", 0), least=0, most=2**63 - 1),
        trials=integer("trials", content.get("trials", _TRIALS), least=1, most=_MAX_TRIALS),
        timeout=_number("timeout", content.get("timeout", math.inf)),
        give_up=_number("give_up", content.get("give_up", _DEFAULT_GIVE_UP), most=1.0),
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
    """Return what may change, which each campaign must have alike and must not vary itself."""
    first, *others = campaigns.values()
    for name in given:
        if not str(name).startswith("mpc."):
            raise UserError(f"search: {name}: expected mpc.PARAMETER: the controller is tuned")
    search = read_variations("search", given, {"mpc": first.base["mpc"]})
    parameters = {target.parameter for target in SearchSpace(search, first).targets}
    for parameter in parameters:
        target = target_of(f"mpc.{parameter}", first.base)
        for name, campaign in campaigns.items():
            for varied in campaign.targets.values():
                if (varied.node, varied.parameter) == ("mpc", parameter):
                    raise UserError(f"search: mpc.{parameter}: {name} varies it: leave one out")
        for other in others:
            mine, theirs = (value_in(target, each.base) for each in (first, other))
            if mine != theirs:
                raise UserError(
                    f"search: mpc.{parameter}: the campaigns begin with {mine} and {theirs}: "
                    "set the same in each"
                )
    return search


def _mapping(content: Mapping[Any, Any], key: str, expected: str) -> dict[Any, Any]:
    given = content.get(key)
    if not isinstance(given, dict) or not given:
        raise ConfigurationError(key, given, expected)
    return given


def _number(name: str, given: Any, *, most: float = math.inf) -> float:
    expected = "a number >= 0" if math.isinf(most) else f"a number from 0 to {most:g}"
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0 <= given <= most:
        raise ConfigurationError(name, given, expected)
    return float(given)
