# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing campaign files, see ``docs/howto/campaigns.md``."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    UserError,
    files,
    ros_yaml,
)
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.extras.campaigns.campaign import (
    SCHEMA,
    Campaign,
    target_of,
    value_in,
)
from quad_mpc_ros.extras.campaigns.variation import SameAs, Variation, variation_of
from quad_mpc_ros.extras.controllers.registry import controller_class
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

_DEFAULT_DURATION = 10.0  # s
_KEYS = (
    *("flights", "seed", "config", "set", "reference", "duration", "settle_time", "start"),
    "vary",
)
_STARTS = ("auto", "ground", "reference")
_MAX_FLIGHTS = 10_000_000
# Parameter files may also have a recorder.
_FILE_SCHEMA: files.Schema = {**SCHEMA, "recorder": RecorderConfig}


def read_content(path: Path, what: str) -> dict[Any, Any]:
    """Return the content of a file of a campaign or study. Raises :class:`UserError`."""
    content = ros_yaml.read_file(path)
    if not isinstance(content, dict):
        raise UserError(f"{path}: expected the keys of a {what}, given {content!r:.60}")
    return content


def content_text(content: Mapping[str, Any]) -> str:
    """Return the text of a file with these keys and exact numbers."""
    return ros_yaml.written(content, sort_keys=False, default_flow_style=None, width=math.inf)


@contextlib.contextmanager
def errors_of(where: str) -> Iterator[None]:
    """Prefix errors with the source of the content."""
    try:
        yield
    except ConfigurationError as error:
        raise error.located(where) from error
    except UserError as error:
        raise UserError(f"{where}: {error}") from error


def check_keys(content: Mapping[Any, Any], known: Sequence[str]) -> None:
    """Raise :class:`UserError` for an unknown key."""
    for key in content:
        if key not in known:
            hint = did_you_mean(str(key), known) or f" ({', '.join(known)})"
            raise UserError(f"unknown key {key!r}{hint}")


def number(name: str, given: Any, *, most: float = sys.float_info.max) -> float:
    """Return a number from 0 to ``most``. Raises :class:`ConfigurationError`."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 <= given <= most:
        expected = "a number >= 0" if most > 1.0 else f"a number from 0 to {most:g}"
        raise ConfigurationError(name, given, expected)
    return float(given)


def integer(name: str, given: Any, *, least: int, most: int) -> int:
    """Return an integer within bounds. Raises :class:`ConfigurationError`."""
    if type(given) is not int or not least <= given <= most:
        raise ConfigurationError(name, given, f"a whole number from {least} to {most}")
    return given


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """Command line options that override a campaign file; None if not given."""

    config: Sequence[str] = ()
    assignments: Sequence[str] = ()
    flights: int | None = None
    seed: int | None = None


def located_campaign(given: Path) -> Path:
    """Return the file at a path or of a shipped campaign. Raises :class:`UserError`."""
    if files.is_file(given):
        return given
    shipped = files.shipped("campaigns")
    if str(given) in shipped:
        return shipped[str(given)]
    raise UserError(f"{given}: no such file, and no shipped campaign ({', '.join(shipped)})")


def read_campaign(path: Path, overrides: Overrides | None = None) -> Campaign:
    """Return the campaign in a file. Raises :class:`UserError` for an unusable file."""
    content = read_content(path, "campaign")
    return campaign_from(content, overrides, where=str(path))


def campaign_from(
    content: Mapping[Any, Any], overrides: Overrides | None = None, *, where: str = "campaign"
) -> Campaign:
    """Return the campaign in the content of a file; ``where`` is the prefix of errors.

    Raises :class:`UserError`.
    """
    with errors_of(where):
        return _Reader(content, overrides or Overrides()).campaign()


def campaign_text(campaign: Campaign) -> str:
    """Return a complete file of a campaign, which refers to no other file."""
    content: dict[str, Any] = {
        "flights": campaign.flights,
        "seed": campaign.seed,
        "config": [],
        "set": {
            f"{node}.{name}": list(value) if isinstance(value, tuple) else value
            for node, values in campaign.given.items()
            for name, value in values.items()
            # A file that sets a varied parameter is rejected.
            if name != "lockstep" and f"{node}.{name}" not in campaign.vary
        },
        "settle_time": campaign.settle_time,
        "start": campaign.start,
        "vary": {name: variation.described() for name, variation in campaign.vary.items()},
    }
    return content_text(content)


def read_variations(
    key: str, given: Mapping[Any, Any], base: Mapping[str, Configuration]
) -> dict[str, Variation]:
    """Return the variations below a key of a file, by parameter names of ``base``.

    Raises :class:`UserError` for unknown names, a vector that varies as a whole and by
    elements, and values that a parameter does not allow.
    """
    vary = {str(name): variation_of(f"{key}: {name}", each) for name, each in given.items()}
    for name, variation in vary.items():
        target = target_of(name, base)
        whole = f"{target.node}.{target.parameter}"
        if target.element is not None and whole in vary:
            raise UserError(f"{key}: {name}: {whole} is also varied: remove one of the two")
        for value in variation.extremes():
            target.validated(value)
        if isinstance(variation, SameAs):
            _check_followed(name, variation, vary, base, key=key)
    return vary


class _Reader:
    """Reads the keys of a campaign file."""

    def __init__(self, content: Mapping[Any, Any], overrides: Overrides) -> None:
        check_keys(content, _KEYS)
        self._content = content
        self._overrides = overrides

    def campaign(self) -> Campaign:
        """Return the campaign, with all values validated."""
        given = self._given()
        base = {node: kind.build(given[node]) for node, kind in SCHEMA.items()}
        simulator = base["simulator"]
        assert isinstance(simulator, SimulatorConfig)
        start = self._content.get("start", "auto")
        if start not in _STARTS:
            raise ConfigurationError("start", start, f"one of {', '.join(_STARTS)}")
        campaign = Campaign(
            flights=self._integer("flights", None, least=1, most=_MAX_FLIGHTS),
            seed=self._integer("seed", 0, least=0, most=2**63 - 1),
            given=given,
            vary=self._vary(base),
            settle_time=self._settle_time(simulator.duration),
            start=start,
        )
        mpc = campaign.configured(campaign.drawn(0)).mpc  # raises for incompatible parameters
        controller_class(mpc.controller)
        return campaign

    def _given(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of files, ``set`` and the command line; later ones override."""
        given = files.collected(self._texts("config", ["default"]), [], schema=_FILE_SCHEMA)
        for node, values in self._set().items():
            given[node].update(values)
        given = files.collected(
            self._overrides.config,
            self._overrides.assignments,
            schema=_FILE_SCHEMA,
            base=given,
        )
        if not given["simulator"].get("duration"):
            given["simulator"]["duration"] = _DEFAULT_DURATION
        # Runs without ROS are in lockstep.
        return {node: {**given[node], "lockstep": True} for node in SCHEMA}

    def _set(self) -> dict[str, dict[str, Any]]:
        """Return the parameters set in the campaign file, by node."""
        found: dict[str, dict[str, Any]] = {node: {} for node in SCHEMA}
        for name, value in self._mapping("set").items():
            node, dot, parameter = str(name).partition(".")
            if not dot or node not in found:
                expected = ", ".join(f"{each}.PARAMETER" for each in found)
                raise UserError(f"set: {name}: expected one of {expected}")
            found[node][parameter] = value
        for key, node, parameter in _SHORTHANDS:
            if key not in self._content:
                continue
            if parameter in found[node]:
                raise UserError(f"{key}: also set as {node}.{parameter}: remove one of them")
            found[node][parameter] = self._content[key]
        return found

    def _vary(self, base: Mapping[str, Configuration]) -> dict[str, Variation]:
        given = self._mapping("vary")
        for name in map(str, given):
            self._refuse_set(name)
        return read_variations("vary", given, base)

    def _refuse_set(self, name: str) -> None:
        """Reject a varied parameter that is also set."""
        assigned = [each.partition("=")[0].strip() for each in self._overrides.assignments]
        if name in self._mapping("set") or name in assigned:
            raise UserError(f"vary: {name}: also set: remove one of them")
        for key, node, parameter in _SHORTHANDS:
            if key in self._content and name == f"{node}.{parameter}":
                raise UserError(f"vary: {name}: also set as {key}: remove one of them")

    def _integer(self, key: str, default: int | None, *, least: int, most: int) -> int:
        """Return an integer of the file, or of the option that overrides it."""
        given = getattr(self._overrides, key)
        if given is not None:
            return integer(f"--{key}", given, least=least, most=most)
        return integer(key, self._content.get(key, default), least=least, most=most)

    def _settle_time(self, duration: float) -> float:
        given = number("settle_time", self._content.get("settle_time", 0.5 * duration))
        if given >= duration:
            raise ConfigurationError(
                "settle_time", given, f"a number >= 0 and below the duration, {duration:g} s"
            )
        return given

    def _texts(self, key: str, default: list[str]) -> list[str]:
        given = self._content.get(key, default)
        listed = [given] if isinstance(given, str) else given
        if not isinstance(listed, list) or not all(isinstance(each, str) for each in listed):
            raise ConfigurationError(key, given, "a list of parameter files or presets")
        return listed

    def _mapping(self, key: str) -> dict[Any, Any]:
        given = self._content.get(key)
        if given is not None and not isinstance(given, dict):
            raise ConfigurationError(key, given, "parameters, node.parameter: …")
        return given or {}


_SHORTHANDS = (("reference", "reference", "trajectory"), ("duration", "simulator", "duration"))
"""Keys of the file that abbreviate one parameter each."""


def _check_followed(
    name: str,
    variation: SameAs,
    vary: Mapping[str, Variation],
    base: Mapping[str, Configuration],
    *,
    key: str,
) -> None:
    """Reject unknown names, circular references, and values that are not allowed."""
    target, source = target_of(name, base), target_of(variation.name, base)
    followed: Variation | None = vary.get(variation.name)
    seen = {name, variation.name}
    while isinstance(followed, SameAs):
        if followed.name in seen:
            raise UserError(f"{key}: {name}: circular reference")
        seen.add(followed.name)
        followed = vary.get(followed.name)
    direct = vary.get(variation.name)
    ends = [value_in(source, base)] if direct is None else direct.extremes()
    for value in ends:
        target.validated(variation.of(value))
