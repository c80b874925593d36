"""The page of a campaign, or of several beside each other: one HTML file that loads nothing."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from quad_mpc_ros.analysis.report.markup import (
    Section,
    empty_figure,
    folded,
    html_page,
    paragraph,
    select,
    tick_box,
    verdict,
)
from quad_mpc_ros.analysis.report.plotting import (
    CAMPAIGN_COLOURS,
    configuration,
    figure_html,
    has_plotly,
    lay_out,
    plotly,
)
from quad_mpc_ros.configuration.atomic_file import write_atomically
from quad_mpc_ros.experiments.campaign_report import campaign_tables as tables
from quad_mpc_ros.experiments.campaign_report.campaign import (
    CRASHES,
    ReportedCampaign,
    all_figures,
    read_campaigns,
)
from quad_mpc_ros.experiments.campaign_report.crash_shares import CrashShares, crash_shares
from quad_mpc_ros.experiments.campaign_report.distributions import BINS, POPULATIONS, distributions
from quad_mpc_ros.experiments.campaign_report.pairs import Pairs, paired
from quad_mpc_ros.experiments.campaign_report.points import (
    MOST_POINTS,
    MOST_WORST,
    flight_points,
    pair_points,
    worst_flights,
)
from quad_mpc_ros.experiments.campaign_report.shares_figure import shares_figure

PAGE_NAME = "report.html"

_FIRST_FIGURE = "position_rmse_m"
_CRASH_TIME = "crash_time_s"
_DRAWN_BY_SCRIPT = ("map", "pair", "distribution", "scatter")
_HEIGHT = 500  # pixels
_CLICK = "A click on a point shows the command that makes its flight again."


def campaign_page(campaigns: Sequence[ReportedCampaign]) -> str:
    """Return the HTML of the report on at least one campaign.

    Of two, the flights of the same vehicle are compared. Raises :class:`UserError` when Plotly is
    not installed.
    """
    pairs = paired(*campaigns) if len(campaigns) == 2 else None
    shares = crash_shares(campaigns)
    sections = [_overview(campaigns)]
    if len(campaigns) > 1:
        sections.append(_comparison(campaigns, pairs))
    sections.append(_crashes(campaigns, shares, pairs))
    if all_figures(campaigns):
        sections += [
            _distributions(campaigns),
            _scatter(campaigns, [each.name for each in shares]),
            _worst(campaigns),
        ]
    sections.append(_errors(campaigns))
    return html_page(
        title=f"quad_mpc report: {'campaign' if len(campaigns) == 1 else 'campaigns'}",
        names=[each.name for each in campaigns],
        verdicts=[_verdict(each) for each in campaigns],
        sections=sections,
        files=[_file(each) for each in campaigns],
        data=_data(campaigns, pairs),
        script="campaign.js",
    )


def write_campaign_page(folder: Path) -> Path | None:
    """Write the page of a campaign into its folder and return its path.

    Returns None where Plotly is not installed: :data:`PLOTLY_NEEDED` says what to do. Raises
    :class:`UserError` for a folder of no campaign and ``OSError``.
    """
    if not has_plotly():
        return None
    path = folder / PAGE_NAME
    name = folder.resolve().name
    write_atomically(path, campaign_page(read_campaigns({name: folder})), overwrite=True)
    return path


def _verdict(campaign: ReportedCampaign) -> str:
    good = len(campaign.table) > 0 and bool(campaign.unharmed.all())
    return verdict(campaign.name, tables.verdict(campaign), good=good)


def _overview(campaigns: Sequence[ReportedCampaign]) -> Section:
    percentiles = [
        f"<h3>Figures of the flights that {population}</h3>\n"
        + tables.percentile_table(campaigns, of)
        for of, population in zip(POPULATIONS, ("did not crash", "were flown"), strict=True)
        if all_figures(campaigns)
    ]
    rest = [folded("And of all, those that crashed included", each) for each in percentiles[1:]]
    parts = [tables.flights_table(campaigns), *percentiles[:1], *rest]
    return Section(key="flights", title="The flights", parts=parts)


def _comparison(campaigns: Sequence[ReportedCampaign], pairs: Pairs | None) -> Section:
    parts = []
    if pairs is None:
        parts.append(paragraph("Flights of the same vehicle are compared of two campaigns."))
    else:
        parts += [paragraph(tables.pair_sentence(pairs)), *_paired(pairs)]
    differing = tables.file_differences(campaigns) or paragraph("Nothing.")
    parts.append(f"<h3>What differs in the campaign files</h3>\n{differing}")
    return Section(key="comparison", title="The same vehicles", parts=parts)


def _paired(pairs: Pairs) -> list[str]:
    if not len(pairs):
        return []
    parts = [tables.outcome_table(pairs)]
    names = [each.name for each in pairs.differences]
    if names:
        controls = [
            select("pair-figure", "figure", names, chosen=_FIRST_FIGURE),
            tick_box("pair-log", "logarithmic"),
        ]
        parts += [
            "<h3>Figures of the vehicles that crashed in neither</h3>",
            tables.difference_table(pairs),
            _hint(
                f"The difference is {pairs.second.name} less {pairs.first.name}. Smaller: of the "
                "pairs that differ, with the 95 % interval of the share."
            ),
            empty_figure("pair", controls, height=_HEIGHT),
            _hint(f"A point is a vehicle; on the line both are equal. {_CLICK}"),
        ]
    return parts


def _crashes(
    campaigns: Sequence[ReportedCampaign], shares: Sequence[CrashShares], pairs: Pairs | None
) -> Section:
    title = "Where it crashed"
    if not any(each.crashed.any() for each in campaigns):
        return Section(key="crashes", title=title, parts=[paragraph("No flight crashed.")])
    drawn = [each for each in shares if each.labels]
    parts = []
    if drawn:
        names = [each.name for each in campaigns]
        figure = figure_html(shares_figure(drawn, names), "shares")
        parts += [
            paragraph(
                "The share of crashed flights over each varied parameter, with its 95 % interval: "
                "numbers in bins of equally many flights. The parameters over which the share "
                "differs most, measured by its chance, come first."
            ),
            f'<div class="wide"><div class="figure">{figure}</div></div>',
        ]
    varied = _map_columns(shares, pairs)
    if len(varied) > 1:
        controls = [
            select("map-x", "across", varied, chosen=varied[0]),
            select("map-y", "up", varied, chosen=varied[1]),
        ]
        shown = "The vehicles that both campaigns flew. " if pairs else ""
        parts += [empty_figure("map", controls, height=_HEIGHT), _hint(shown + _CLICK)]
    return Section(key="crashes", title=title, parts=parts)


def _map_columns(shares: Sequence[CrashShares], pairs: Pairs | None) -> list[str]:
    """Return what the map of crashes may be drawn over, the most uneven first."""
    names = [each.name for each in shares]
    return [name for name in names if name in pairs.shared] if pairs else names


def _distributions(campaigns: Sequence[ReportedCampaign]) -> Section:
    controls = [
        select("distribution-figure", "figure", all_figures(campaigns), chosen=_FIRST_FIGURE),
        select("distribution-of", "of flights that", POPULATIONS),
        select("distribution-as", "as", ("histogram", "cumulative share")),
        tick_box("distribution-log", "logarithmic"),
    ]
    return Section(
        key="distribution",
        title="Distribution of a figure",
        parts=[
            empty_figure("distribution", controls, height=_HEIGHT),
            _hint(f"Of all these flights; a histogram has {BINS} bins."),
        ],
    )


def _scatter(campaigns: Sequence[ReportedCampaign], varied: Sequence[str]) -> Section:
    figures = [*all_figures(campaigns), _CRASH_TIME]
    controls = [
        select("scatter-y", "figure", figures, chosen=_FIRST_FIGURE),
        select("scatter-x", "over", [*varied, *figures]),
        tick_box("scatter-log-y", "figure logarithmic"),
        tick_box("scatter-log-x", "column logarithmic"),
    ]
    return Section(
        key="scatter",
        title="A figure over a column",
        parts=[empty_figure("scatter", controls, height=_HEIGHT), _hint(_CLICK)],
    )


def _worst(campaigns: Sequence[ReportedCampaign]) -> Section:
    return Section(
        key="worst",
        title="The worst flights",
        parts=[
            f"<p>{select('worst-by', 'by', all_figures(campaigns), chosen=_FIRST_FIGURE)}</p>",
            '<div class="wide" id="worst-table"></div>',
            _hint(f"At most {MOST_WORST} that crashed, then at most {MOST_WORST} that did not."),
        ],
    )


def _errors(campaigns: Sequence[ReportedCampaign]) -> Section:
    found = {each.name: tables.error_table(each) for each in campaigns}
    heading = "<h3>{}</h3>\n" if len(campaigns) > 1 else ""
    parts = [heading.format(escape(name)) + table for name, table in found.items() if table]
    return Section(
        key="errors", title="Errors", parts=parts or [paragraph("No flight raised an error.")]
    )


def _file(campaign: ReportedCampaign) -> str:
    text = campaign.text
    shown = paragraph("It is not there.") if text is None else f"<pre>{escape(text)}</pre>"
    return folded(f"campaign.yaml of {campaign.name}", shown)


def _hint(text: str) -> str:
    return paragraph(text, "hint")


def _data(campaigns: Sequence[ReportedCampaign], pairs: Pairs | None) -> dict[str, Any]:
    """Return what the script draws."""
    colours = [CAMPAIGN_COLOURS[n % len(CAMPAIGN_COLOURS)] for n in range(len(campaigns))]
    several, most = len(campaigns) > 1, MOST_POINTS // len(campaigns)
    empty = plotly("graph_objects").Figure()
    lay_out(empty, height=_HEIGHT, margin={"l": 80, "r": 20, "b": 60}, hovermode="closest")
    return {
        "layout": empty.layout.to_plotly_json(),
        "config": {key: configuration(key) for key in _DRAWN_BY_SCRIPT},
        "names": [each.name for each in campaigns],
        "colours": colours,
        "crashes": CRASHES,
        "flights": [
            flight_points(each, most=most, colour=colour if several else None)
            for each, colour in zip(campaigns, colours, strict=True)
        ],
        "pairs": pair_points(pairs, most=MOST_POINTS) if pairs else None,
        "distributions": distributions(campaigns),
        "worst": [
            {name: worst_flights(each, name) for name in all_figures(campaigns)}
            for each in campaigns
        ],
    }
