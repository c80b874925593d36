# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Words and sentences that neither code nor pages use, as CONTRIBUTING.md explains."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT, PACKAGE = Path(__file__).resolve().parents[2], "quad_mpc_ros"
FOLDERS = (PACKAGE, "test", "bench", "tools", "examples", "launch")
CODE = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
CODE.remove(Path(__file__).resolve())
# Decisions are kept as they were written. CONTRIBUTING.md has to name the words.
DOCUMENTS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [ROOT / "README.md", *(page for page in DOCUMENTS if page.parent.name != "adr")]
GUIDES = [page for page in PAGES if page.parent.name in ("tutorials", "howto", "stacks")]

REFUSED = {
    *("anew", "believe", "believed", "believes", "everybody", "feel", "feels", "felt"),
    *("hear", "heard", "hears", "lest", "mend", "mended", "mends", "nobody", "somebody"),
    *("tells", "told", "whoever", "whomever"),
}
OPENING = re.compile(
    r"(?:^|[.:?!]\s+)(Of an? |Of those |That of |Those of |Who \w+ \w+ (?!\w*\?)"
    r"|What [^.?]{1,60} (?:says|tells)\b)"
)
MOST_WORDS_OF_README, MOST_WORDS_OF_PAGES, MOST_WORDS_OF_SENTENCE = 1500, 45_000, 35
GENERATED = "docs/reference/parameters.md"


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_no_refused_word_is_used() -> None:
    found = {name_of(path): used for path in [*CODE, *PAGES] if (used := refused_words(path))}
    assert not found


def refused_words(path: Path) -> set[str]:
    """Return refused words of a path and its text, also as parts of identifiers."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+", f"{name_of(path)} {path.read_text()}")
    return REFUSED & {word.lower() for word in words}


def test_no_sentence_opens_in_a_refused_way() -> None:
    code = [(name_of(path), text) for path in CODE for text in prose_of(path)]
    pages = [(name_of(page), prose_of_page(page)) for page in PAGES]
    assert not [(name, found) for name, text in code + pages for found in OPENING.findall(text)]


@pytest.mark.parametrize("page", GUIDES, ids=name_of)
def test_sentences_of_guides_are_short(page: Path) -> None:
    sentences = re.split(r"(?<=[.!?:;])\s+|\n\s*\n|\n\s*(?:[-*|#>]|\d+\.)", prose_of_page(page))
    assert not [each for each in sentences if len(each.split()) > MOST_WORDS_OF_SENTENCE]


@pytest.mark.parametrize("page", [ROOT / "CONTRIBUTING.md", *DOCUMENTS])
def test_files_that_a_page_names_exist(page: Path) -> None:
    named = re.findall(r"`((?:[a-z_0-9]+/)+[a-z_0-9]+\.(?:py|yaml))`", page.read_text())
    real = [name for name in named if "kite" not in name]  # the example of CONTRIBUTING.md
    assert all((ROOT / name).exists() or (ROOT / PACKAGE / name).exists() for name in real)


def test_readme_is_read_in_five_minutes() -> None:
    assert len((ROOT / "README.md").read_text().split()) <= MOST_WORDS_OF_README


def test_pages_are_short_enough_to_be_read() -> None:
    words = {name_of(page): re.findall(r"\S*\w\S*", page.read_text()) for page in PAGES}
    assert sum(len(found) for page, found in words.items() if page != GENERATED) <= (
        MOST_WORDS_OF_PAGES
    )


def prose_of(path: Path) -> Iterator[str]:
    """Yield comments and texts of a file of Python."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("# ")
        elif token.type == tokenize.STRING:
            yield re.sub(r"\s+", " ", token.string.strip("rbf\"'"))


def prose_of_page(path: Path) -> str:
    """Return a page without code, tables and links' targets."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^\s*\|.*$", "", text, flags=re.MULTILINE)
    return re.sub(r"\]\([^)]*\)", "]", text)
