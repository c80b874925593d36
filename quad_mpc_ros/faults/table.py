"""The faults as a table for people."""

from __future__ import annotations

from quad_mpc_ros.faults.cases import FAULTS
from quad_mpc_ros.faults.courses import described
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.text_tables import markdown_table


def fault_table() -> str:
    """Return in Markdown what is injected and, with default parameters, what must follow."""
    config = MpcConfig()
    rows = [
        (
            f"`{fault.name}`",
            fault.injected,
            f"{fault.duration:g}",
            described(fault.course(config), fault.duration),
            f"{fault.recovery(config):.2f} s",
        )
        for fault in FAULTS.values()
    ]
    return markdown_table(("fault", "injected", "s", "must lead to", "MPC again within"), rows)
