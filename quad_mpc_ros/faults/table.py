"""The faults as a table for people."""

from __future__ import annotations

from quad_mpc_ros.faults.cases import FAULTS
from quad_mpc_ros.faults.courses import described
from quad_mpc_ros.mpc_config import MpcConfig


def fault_table() -> str:
    """Return in Markdown what is injected and, with default parameters, what must follow."""
    config = MpcConfig()
    lines = ["| fault | injected | s | must lead to | MPC again within |", "|---|---|---|---|---|"]
    lines += [
        f"| `{fault.name}` | {fault.injected} | {fault.duration:g} | "
        f"{described(fault.course(config), fault.duration)} | {fault.recovery(config):.2f} s |"
        for fault in FAULTS.values()
    ]
    return "\n".join(lines)
