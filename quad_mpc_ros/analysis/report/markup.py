"""Parts of a page: tables, links, JSON in a script, the files that lie beside this one."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from string import Template
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.analysis.report.plotting import plotly


def html_table(
    columns: Sequence[str],
    rows: Mapping[str, Sequence[str]],
    *,
    groups: Sequence[str] = (),
    numbers: bool = False,
) -> str:
    """Return a table of text, which is escaped here.

    Args:
        columns: What stands above the cells.
        rows: The cells of each row by what stands before them.
        groups: What stands above as many columns each; nothing without.
        numbers: Whether cells are aligned to the right.
    """
    head = _head_row(columns)
    span = len(columns) // len(groups) if groups else len(columns)
    if groups:
        head = _head_row(groups, span=span) + head
    body = "\n".join(
        f"<tr><th>{escape(name)}</th>"
        + "".join(
            f'<td class="first">{escape(cell)}</td>'
            if groups and place % span == 0
            else f"<td>{escape(cell)}</td>"
            for place, cell in enumerate(cells)
        )
        + "</tr>"
        for name, cells in rows.items()
    )
    kind = ' class="numbers"' if numbers else ""
    return (
        f'<div class="wide"><table{kind}>\n<thead>{head}</thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def select(key: str, label: str, names: Iterable[str], *, chosen: str = "") -> str:
    """Return a labelled choice of names."""
    options = "".join(
        f"<option{' selected' if name == chosen else ''}>{escape(name)}</option>" for name in names
    )
    return f'<label>{escape(label)} <select id="{key}">{options}</select></label>'


def tick_box(key: str, label: str) -> str:
    """Return a labelled box to tick."""
    return f'<label><input type="checkbox" id="{key}"> {escape(label)}</label>'


def empty_figure(key: str, controls: Sequence[str], *, height: int) -> str:
    """Return the place of a figure that the page's script draws, below what steers it.

    Its id is ``figure-`` and the key; below it is a place for notes.
    """
    return (
        f'<p class="controls">{" ".join(controls)}</p>\n'
        f'<p class="hint" id="{key}-notes"></p>\n'
        f'<div class="wide"><div class="figure" id="figure-{key}" style="height: {height}px">'
        f'</div></div>\n<pre class="again" id="{key}-again"></pre>'
    )


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of text, which is escaped here."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(texts: Sequence[str]) -> str:
    """Return a list of texts, which are escaped here."""
    return "<ul>\n" + "\n".join(f"<li>{escape(text)}</li>" for text in texts) + "\n</ul>"


def verdict(name: str, text: str, *, good: bool) -> str:
    """Return the paragraph that says how a run or a campaign went."""
    kind = "good" if good else "bad"
    return f'<p class="{kind}"><b>{escape(name)}</b>: {escape(text)}</p>'


def folded(summary: str, content: str) -> str:
    """Return content that a click on its summary shows."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}</details>"


@dataclass(frozen=True, kw_only=True)
class Section:
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
    title: str,
    names: Sequence[str],
    verdicts: Sequence[str],
    facts: Sequence[str] = (),
    hint: str = "",
    sections: Sequence[Section],
    files: Sequence[str],
    data: Any,
    script: str,
) -> str:
    """Return a page that loads nothing: its data, style, script and Plotly are inside.

    Args:
        title: What the window is called, followed by the names.
        names: What the page is about.
        verdicts: Paragraphs below the names, each a :func:`verdict`.
        facts: What stands before the links to the sections.
        hint: What to do with the figures.
        sections: The sections that links lead to.
        files: What follows them.
        data: What the script shows, by its name ``data``.
        script: A file beside this one.

    Raises :class:`UserError` when Plotly is not installed.
    """
    return Template(_asset("page.html")).substitute(
        title=escape(f"{title} {', '.join(names)}"),
        style=_asset("page.css"),
        plotly=plotly("offline").get_plotlyjs(),
        names=escape(", ".join(names)),
        verdicts="\n".join(verdicts),
        facts=_joined(facts),
        links="\n".join(each.link for each in sections),
        hint=paragraph(hint, "hint") if hint else "",
        sections="\n".join(each.html for each in sections),
        files="\n".join(files),
        version=escape(__version__),
        # Escaped, it cannot end the element it stands in.
        data=json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
        script=_asset(script),
    )


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _joined(parts: Iterable[str]) -> str:
    return "\n".join(part for part in parts if part)


def _head_row(cells: Sequence[str], *, span: int = 1) -> str:
    spanning = f' colspan="{span}"' if span > 1 else ""
    return (
        "<tr><th></th>" + "".join(f"<th{spanning}>{escape(cell)}</th>" for cell in cells) + "</tr>"
    )
