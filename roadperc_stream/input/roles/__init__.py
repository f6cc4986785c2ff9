"""Which channel of a log is assigned to which role."""

from roadperc_stream.input.roles.assignment import (
    NOTHING_TO_REPLAY,
    RoleAssignment,
    RoleFilling,
    assign_roles,
    assignment_of_log,
    candidates,
    channel_state,
    tag_table_to_record,
)
from roadperc_stream.input.roles.probe import ContentProbe, no_probe, probe_first_message
from roadperc_stream.input.roles.topic_names import CAMERA_OF, distinct, fits

__all__ = [
    "CAMERA_OF",
    "NOTHING_TO_REPLAY",
    "ContentProbe",
    "RoleAssignment",
    "RoleFilling",
    "assign_roles",
    "assignment_of_log",
    "candidates",
    "channel_state",
    "distinct",
    "fits",
    "no_probe",
    "probe_first_message",
    "tag_table_to_record",
]
