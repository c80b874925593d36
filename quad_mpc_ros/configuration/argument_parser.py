"""Command lines that refuse in one line."""

from __future__ import annotations

import argparse
from typing import NoReturn

_EXIT_BAD_INPUT = 2


class ArgumentParser(argparse.ArgumentParser):
    """Says in one line what is wrong, as everything else does, and where it is explained."""

    def error(self, message: str) -> NoReturn:
        """End with what is wrong."""
        self.exit(_EXIT_BAD_INPUT, f"error: {message}\nsee {self.prog} --help\n")
