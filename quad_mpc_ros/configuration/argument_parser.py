# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Command lines that report errors in one line."""

from __future__ import annotations

import argparse
from typing import NoReturn

_EXIT_BAD_INPUT = 2


class ArgumentParser(argparse.ArgumentParser):
    """Reports errors of the command line in one line, with a pointer to ``--help``."""

    def error(self, message: str) -> NoReturn:
        """Exit with the error message."""
        self.exit(_EXIT_BAD_INPUT, f"error: {message}\nsee {self.prog} --help\n")
