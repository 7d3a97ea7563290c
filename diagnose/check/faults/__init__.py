"""One fault a file; importing this package registers them, in the order in which they run."""

from diagnose.check.faults import channel_skew as channel_skew
from diagnose.check.faults import clipping as clipping
from diagnose.check.faults import command_as_torque as command_as_torque
from diagnose.check.faults import constant_input as constant_input
from diagnose.check.faults import duplicated_rows as duplicated_rows
from diagnose.check.faults import hold as hold
from diagnose.check.faults import joint_range as joint_range
from diagnose.check.faults import joint_stop as joint_stop
from diagnose.check.faults import low_pass as low_pass
from diagnose.check.faults import quantisation as quantisation
from diagnose.check.faults import same_column as same_column
from diagnose.check.faults import sample_rate as sample_rate
from diagnose.check.faults import short as short
from diagnose.check.faults import side as side
from diagnose.check.faults import sign as sign
from diagnose.check.faults import skew as skew
from diagnose.check.faults import spike as spike
from diagnose.check.faults import stamps as stamps
from diagnose.check.faults import unit as unit
from diagnose.check.faults import unknown_gear as unknown_gear
from diagnose.check.faults import unknown_scale as unknown_scale
