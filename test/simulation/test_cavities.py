import numpy as np
from softrobot_twin.simulation import CommandSetpoints, CommandEfforts, Hold, FollowTargets
def test_try(inflatable):
    for control in ("pressure","volume"):
        s = inflatable(control=control)
        print(s.notes, s.rest_setpoints, s.actuators.limits)
        for i in range(6):
            target = 5e3 if control=="pressure" else s.rest_setpoints[0]*1.3
            r = s.step(CommandSetpoints([target], 0.02))
            print(r.status, r.setpoints, r.efforts, r.displacements, r.report.residual, r.report.iterations, r.report.active_limits)
    assert 0
