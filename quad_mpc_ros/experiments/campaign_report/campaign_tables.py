"""How campaigns went, as sentences and HTML tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quad_mpc_ros.analysis.report.markup import html_table
from quad_mpc_ros.configuration.errors import shown
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.experiments.campaign_report.campaign import (
    CRASHES,
    ReportedCampaign,
    all_figures,
)
from quad_mpc_ros.experiments.campaign_report.distributions import POPULATIONS
from quad_mpc_ros.experiments.campaign_report.pairs import (
    BOTH,
    ERROR,
    FIRST,
    NEITHER,
    SECOND,
    Pairs,
)
from quad_mpc_ros.experiments.campaign_report.proportion import Proportion
from quad_mpc_ros.experiments.campaigns.table import NUMBER
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles

ABSENT = "–"
MOST_ERRORS = 20  # different ones
_MOST_LISTED = 10  # flights of an error

_PERCENTILES = ("min", "p50", "p95", "p99", "max")


def verdict(campaign: ReportedCampaign) -> str:
    """Return in a few sentences how a campaign went."""
    table = campaign.table
    flown, errors = int(np.sum(table.flown)), int(np.sum(~table.flown))
    text = f"{_counted(len(table), 'flight')}. "
    text += f"{errors} raised an error. " if errors else ""
    text += f"{_crashed(campaign)} crashed{_by_kind(campaign)}. " if flown else "None was flown. "
    rmse = _percentiles(campaign.numbers("position_rmse_m")[campaign.unharmed])
    if rmse:
        text += (
            f"Of those that did not, position RMSE is {rmse['p50']:.3g} m at the median, "
            f"{rmse['p95']:.3g} m at p95, {rmse['max']:.3g} m at most."
        )
    return text.strip()


def flights_table(campaigns: Sequence[ReportedCampaign]) -> str:
    """Return how many flights there are, and what became of them."""
    rows = {
        "folder": [str(each.folder) for each in campaigns],
        "varied parameters": [", ".join(each.table.varied) or ABSENT for each in campaigns],
        "flights": [str(len(each.table)) for each in campaigns],
        "errors": [str(int(np.sum(~each.table.flown))) for each in campaigns],
        "crashed of those flown (95 % interval)": [str(_crashed(each)) for each in campaigns],
    }
    kinds = [each.crash_kinds() for each in campaigns]
    for kind in dict.fromkeys(kind for each in kinds for kind in each):
        rows[CRASHES.get(kind, kind or "not said how")] = [
            str(each.get(kind, 0)) for each in kinds
        ]
    rows["did not crash"] = [str(int(np.sum(each.unharmed))) for each in campaigns]
    return html_table([each.name for each in campaigns], rows)


def percentile_table(campaigns: Sequence[ReportedCampaign], population: str) -> str:
    """Return the percentiles of every figure over some of the flights."""
    chosen = [POPULATIONS[population](each) for each in campaigns]
    rows = {}
    for name in all_figures(campaigns):
        found = [
            _percentiles(each.numbers(name)[mask])
            for each, mask in zip(campaigns, chosen, strict=True)
        ]
        rows[name] = [number(each.get(one)) for each in found for one in _PERCENTILES]
    groups = [f"{each.name}: " if len(campaigns) > 1 else "" for each in campaigns]
    return html_table(
        [*_PERCENTILES] * len(campaigns),
        rows,
        groups=[
            f"{name}{_counted(int(np.sum(mask)), 'flight')}"
            for name, mask in zip(groups, chosen, strict=True)
        ],
        numbers=True,
    )


def error_table(campaign: ReportedCampaign) -> str:
    """Return the errors that flights raised, the most frequent first; empty without."""
    errors = campaign.table.columns["error"]
    texts, counts = np.unique(errors[~campaign.table.flown], return_counts=True)
    rows: dict[str, list[str]] = {}
    for place in np.argsort(-counts, kind="stable")[:MOST_ERRORS].tolist():
        text = str(texts[place])
        numbers = campaign.table.columns[NUMBER][errors == text].tolist()
        more = ", …" if len(numbers) > _MOST_LISTED else ""
        listed = ", ".join(map(str, numbers[:_MOST_LISTED])) + more
        known = campaign.parameter_file(numbers[0]).is_file()
        again = campaign.command(numbers[0]) if known else ABSENT
        rows[listed] = [str(counts[place]), text, again]
    return html_table(["flights", "error", "the first again"], rows) if rows else ""


def pair_sentence(pairs: Pairs) -> str:
    """Return how many flights two campaigns have in common, or why none."""
    first, second = pairs.first, pairs.second
    if not pairs.shared:
        return (
            f"{first.name} and {second.name} vary no parameter in common, so no flight of one is "
            "the same vehicle in the other."
        )
    rule = (
        "the same number, and equal values of "
        f"{_counted(len(pairs.shared), 'parameter')} that both vary ({', '.join(pairs.shared)})"
    )
    sizes = f"{len(first.table)} of {first.name} and {len(second.table)} of {second.name}"
    if not len(pairs):
        return (
            f"No flight is the same vehicle in both: {rule}. There are {sizes}; campaigns over "
            "the same vehicles have the same seed and the same distributions."
        )
    return f"{_counted(len(pairs), 'flight')} of {sizes} are the same vehicle in both: {rule}."


def outcome_table(pairs: Pairs) -> str:
    """Return in which campaign the same vehicles crashed."""
    counts, known = pairs.counts, len(pairs) - pairs.counts[ERROR]
    first, second = pairs.first.name, pairs.second.name
    rows = {
        "crashed in both": counts[BOTH],
        f"crashed only in {first}": counts[FIRST],
        f"crashed only in {second}": counts[SECOND],
        "crashed in neither": counts[NEITHER],
    }
    cells = {name: [str(Proportion(count=each, total=known))] for name, each in rows.items()}
    cells["error in one of them"] = [str(counts[ERROR])]
    return html_table(["the same vehicles (95 % interval)"], cells)


def difference_table(pairs: Pairs) -> str:
    """Return how figures differ between two flights of the same vehicle that did not crash."""
    first, second = pairs.first.name, pairs.second.name
    rows = {
        each.name: [
            str(each.count),
            number(each.first_median),
            number(each.second_median),
            number(each.median_difference),
            str(each.smaller) if each.smaller.total else "all equal",
        ]
        for each in pairs.differences
    }
    columns = [
        "pairs",
        f"median, {first}",
        f"median, {second}",
        "median difference",
        f"smaller in {second}",
    ]
    return html_table(columns, rows, numbers=True) if rows else ""


def file_differences(campaigns: Sequence[ReportedCampaign]) -> str:
    """Return the entries of the campaign files that are not the same in all; empty without."""
    entries = [each.entries for each in campaigns]
    rows = {
        name: [shown(each[name]) if name in each else ABSENT for each in entries]
        for name in dict.fromkeys(name for each in entries for name in each)
    }
    rows = {name: cells for name, cells in rows.items() if len(set(cells)) > 1}
    return html_table([each.name for each in campaigns], rows) if rows else ""


def number(value: float | None) -> str:
    """Return a figure as a table shows it."""
    return ABSENT if value is None or not np.isfinite(value) else f"{value:.4g}"


def _percentiles(values: Array) -> dict[str, float | None]:
    known = values[np.isfinite(values)]
    if not len(known):
        return {}
    return {"min": float(known.min()), **percentiles(known, 50, 95, 99)}


def _crashed(campaign: ReportedCampaign) -> Proportion:
    return Proportion(count=int(np.sum(campaign.crashed)), total=int(np.sum(campaign.table.flown)))


def _by_kind(campaign: ReportedCampaign) -> str:
    kinds = {kind: count for kind, count in campaign.crash_kinds().items() if count}
    listed = ", ".join(
        f"{count} {CRASHES.get(kind, kind or 'not said how')}" for kind, count in kinds.items()
    )
    return f": {listed}" if listed else ""


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
