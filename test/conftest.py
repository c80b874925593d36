"""What every test needs: a ROS domain of its own on the loopback, and the house's tools."""

from __future__ import annotations

import os
import socket

# Before anything imports NumPy: its threads gain nothing on small matrices but wait for others.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Before anything imports rclpy. A free domain per run, so that two runs on one machine do not
# hear each other: participant 0 of domain d owns UDP port 7400 + 250 d + 10.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def _free_domain() -> int:
    for domain in range(20, 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise RuntimeError("no free ROS domain between 20 and 99")


os.environ["ROS_DOMAIN_ID"] = str(_free_domain())
