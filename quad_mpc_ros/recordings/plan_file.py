"""A planned motion as an MCAP file: viewers show it, and ``reference.file`` names it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.messages.topics import REFERENCE, REFERENCE_PATH
from quad_mpc_ros.recordings.mcap_output import McapOutput, RecordedTopic
from quad_mpc_ros.recordings.qos_profile import QosProfile
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.references.motion_table import MotionTable

PLAN, PATH = "/plan", "/plan/path"
_PLANNED_WITH = "planned_with"
_BODY_FRAME = "base_link"
_SHOWN_NS = 20_000_000  # from one pose of the path to the next


def write_plan(path: Path, table: MotionTable, *, frame_id: str) -> None:
    """Write a motion as one ``MultiDOFJointTrajectory``, and a ``Path`` for viewers.

    Raises ``OSError``; a file that exists is left as it is.
    """
    seconds = table.seconds - table.seconds[0]
    R_WB = so3.rotation_from_quaternion_xyzw(table.q_WB_xyzw)
    window = ReferenceWindow(
        stamp_ns=0,
        frame_id=frame_id,
        offset_ns=np.round(1e9 * seconds).astype(np.int64),
        p_WB=table.p_WB,
        q_WB_xyzw=table.q_WB_xyzw,
        v_WB_W=table.v_WB_W,
        a_WB_W=table.a_WB_W,
        w_WB_W=np.einsum("nij,nj->ni", R_WB, table.w_WB_B),
    )
    shown = np.searchsorted(window.offset_ns, np.arange(0, window.offset_ns[-1], _SHOWN_NS))
    line = cdr.written_path(
        stamp_ns=0,
        step_ns=_SHOWN_NS,
        frame_id=frame_id,
        p_WB=table.p_WB[shown],
        q_WB_xyzw=table.q_WB_xyzw[shown],
    )
    whole = cdr.written_reference(window, child_frame_id=_BODY_FRAME)
    latched = QosProfile(depth=1, durability="transient_local")
    output = McapOutput(path, compression="zstd", durable=True)
    for name, topic, data in ((PLAN, REFERENCE, whole), (PATH, REFERENCE_PATH, line)):
        schema = schema_for(topic.type_name)
        output.add_topic(RecordedTopic(name=name, schema=schema, qos_profiles=[latched]))
        output.write(name, data, log_time_ns=0, publish_time_ns=0)
    output.write_metadata(PLAN, {_PLANNED_WITH: table.planned_with})
    output.finish()


def read_plan(bag: Path) -> MotionTable | None:
    """Return the plan in a bag, or None where there is none. Raises :class:`UserError`."""
    reader = BagReader(bag)
    if PLAN not in reader.topics:
        return None
    reader.require_cdr([PLAN])
    message = next(reader.messages([PLAN]), None)
    if message is None or reader.topics[PLAN].type_name != REFERENCE.type_name:
        raise UserError(f"{bag}: {PLAN} has no {REFERENCE.type_name}: plan it anew")
    try:
        window = conversions.reference_from_message(message.message)
    except ValueError as error:
        raise UserError(f"{bag}: {PLAN}: {error}") from error
    R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw)
    return MotionTable(
        source=str(bag),
        seconds=1e-9 * window.offset_ns.astype(np.float64),
        p_WB=window.p_WB,
        v_WB_W=window.v_WB_W,
        a_WB_W=window.a_WB_W,
        q_WB_xyzw=window.q_WB_xyzw,
        w_WB_B=np.einsum("nji,nj->ni", R_WB, window.w_WB_W),
        planned_with=reader.metadata.get(PLAN, {}).get(_PLANNED_WITH, ""),
    )
