"""Parts of a page: tables, links, the files that lie beside this one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from string import Template

from quad_mpc_ros import __version__
from quad_mpc_ros.analysis.report.plotting import plotly


def html_table(columns: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    """Return a table of text, which is escaped here.

    Args:
        columns: The headings of the cells.
        rows: The cells of each row by the heading of the row.
    """
    head = "<tr><th></th>" + "".join(f"<th>{escape(cell)}</th>" for cell in columns) + "</tr>"
    body = "\n".join(
        f"<tr><th>{escape(name)}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for name, cells in rows.items()
    )
    return (
        f'<div class="wide"><table>\n<thead>{head}</thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def paragraph(text: str) -> str:
    """Return a paragraph of text, which is escaped here."""
    return f"<p>{escape(text)}</p>"


def bullets(texts: Sequence[str]) -> str:
    """Return a list of texts, which are escaped here."""
    return "<ul>\n" + "\n".join(f"<li>{escape(text)}</li>" for text in texts) + "\n</ul>"


def verdict(name: str, text: str, *, good: bool) -> str:
    """Return the paragraph that says how a run went."""
    kind = "good" if good else "bad"
    return f'<p class="{kind}"><b>{escape(name)}</b>: {escape(text)}</p>'


def folded(summary: str, content: str) -> str:
    """Return content that a click on its summary shows."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}</details>"


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A part of the page that links lead to by its ``key``; its parts are HTML."""

    key: str
    title: str
    parts: Sequence[str]

    @property
    def html(self) -> str:
        """The section."""
        body = _joined(self.parts)
        return f'<section id="{self.key}"><h2>{escape(self.title)}</h2>\n{body}\n</section>'

    @property
    def link(self) -> str:
        """A link to it."""
        return f'<a href="#{self.key}">{escape(self.title)}</a>'


def html_page(
    *,
    names: Sequence[str],
    verdicts: Sequence[str],
    facts: Sequence[str],
    hint: str,
    sections: Sequence[PageSection],
    end: str,
) -> str:
    """Return a page that loads nothing: its style, script and Plotly are inside.

    Args:
        names: The runs.
        verdicts: Paragraphs below the names, each a :func:`verdict`.
        facts: What stands before the links to the sections.
        hint: What to do with the figures.
        sections: The sections that links lead to.
        end: What follows them.

    Raises :class:`UserError` when Plotly is not installed.
    """
    return Template(_asset("page.html")).substitute(
        title=escape(f"quad_mpc report: {', '.join(names)}"),
        style=_asset("page.css"),
        plotly=plotly("offline").get_plotlyjs(),
        names=escape(", ".join(names)),
        verdicts="\n".join(verdicts),
        facts=_joined(facts),
        links="\n".join(each.link for each in sections),
        hint=f'<p class="hint">{escape(hint)}</p>',
        sections="\n".join(each.html for each in sections),
        end=end,
        version=escape(__version__),
        script=_asset("runs.js"),
    )


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _joined(parts: Iterable[str]) -> str:
    return "\n".join(part for part in parts if part)
