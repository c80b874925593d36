"""A campaign as the report shows it: its table, its file, how to make each flight again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.configuration.errors import os_reason
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.campaigns.campaign import number_text
from quad_mpc_ros.experiments.campaigns.flying import CAMPAIGN_NAME, FLIGHTS_NAME
from quad_mpc_ros.experiments.campaigns.table import CSV_NAME, NUMBER, CampaignTable, read_table

CRASHES = {"ground": "hit the ground", "upside_down": "turned over", "away": "flew away"}
"""The kinds of crash of the table, in words."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportedCampaign:
    """One campaign.

    Attributes:
        name: Unique in the report.
        folder: As the user wrote it, for the commands on the page.
        table: Its flights.
        text: Its campaign.yaml; None where there is none.
    """

    name: str
    folder: Path
    table: CampaignTable
    text: str | None = None

    @property
    def unharmed(self) -> NDArray[np.bool_]:
        """Which flights neither raised an error nor crashed (n,)."""
        return self.table.flown & ~self.table.crashed

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Which flights crashed and raised no error (n,)."""
        return self.table.flown & self.table.crashed

    @cached_property
    def figures(self) -> tuple[str, ...]:
        """The names of the figures that are numbers and that any flight has a value of."""
        return tuple(name for name in self.table.figures if np.isfinite(self.numbers(name)).any())

    def numbers(self, name: str) -> Array:
        """Return a column (n,), NaN for no value; all NaN for texts and for what is no column."""
        column = self.table.columns.get(name)
        if column is None or column.dtype.kind not in "fi":
            return np.full(len(self.table), np.nan)
        return np.asarray(column, dtype=np.float64)

    def crash_kinds(self) -> dict[str, int]:
        """Return how many flights crashed, by kind: the known kinds, and others that occur."""
        kinds = self.table.columns["crash"][self.crashed].tolist()
        return {kind: kinds.count(kind) for kind in [*CRASHES, *sorted(set(kinds) - set(CRASHES))]}

    @cached_property
    def command_parts(self) -> tuple[str, str]:
        """What stands before and after the number in the command that makes a flight again."""
        zeros = "0" * self.digits
        before, _, after = shlex.quote(str(self.parameter_file(0))).rpartition(zeros)
        return f"quad_mpc simulate --config {before}", after

    @cached_property
    def digits(self) -> int:
        """How many digits the number of a flight has in the name of its file."""
        return len(number_text(0, self._planned))

    def command(self, number: int) -> str:
        """Return the command that makes a flight again."""
        before, after = self.command_parts
        return f"{before}{number:0{self.digits}d}{after}"

    def parameter_file(self, number: int) -> Path:
        """Return where the parameters of a flight are; one that was lost has none."""
        return self.folder / FLIGHTS_NAME / f"{number:0{self.digits}d}.yaml"

    @cached_property
    def entries(self) -> dict[str, Any]:
        """The entries of campaign.yaml by dotted name; none of what is no YAML."""
        try:
            content = yaml.safe_load(self.text or "")
        except (yaml.YAMLError, ValueError):  # a ValueError for a date that is none
            return {}
        return dict(files.flattened(content)) if isinstance(content, dict) else {}

    @property
    def _planned(self) -> int:
        """How many flights there were to be, flown or not."""
        flights = self.entries.get("flights")
        found = 1 + max(self.table.columns[NUMBER].tolist(), default=0)
        return max(flights, found) if isinstance(flights, int) else found


def is_campaign(folder: Path) -> bool:
    """Whether a folder is that of a campaign: whether it has the table of its flights."""
    return (folder / CSV_NAME).is_file()


def read_campaigns(folders: Mapping[str, Path]) -> list[ReportedCampaign]:
    """Read campaigns by their names. Raises :class:`UserError` for a folder of none."""
    return [
        ReportedCampaign(name=name, folder=folder, table=read_table(folder), text=_text(folder))
        for name, folder in folders.items()
    ]


def all_figures(campaigns: Sequence[ReportedCampaign]) -> list[str]:
    """Return the names of the figures that any of the campaigns has."""
    return list(dict.fromkeys(name for each in campaigns for name in each.figures))


def all_varied(campaigns: Sequence[ReportedCampaign]) -> list[str]:
    """Return the names of the parameters that any of the campaigns varies."""
    return list(dict.fromkeys(name for each in campaigns for name in each.table.varied))


def _text(folder: Path) -> str | None:
    path = folder / CAMPAIGN_NAME
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {os_reason(error)}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: cannot be read: {error}") from error
