"""The identified device as a passive force on joints and tendons of a MuJoCo model.

    import mujoco, isolator_mujoco
    isolator_mujoco.install(isolator_mujoco.Device(model, joint="isolator"))     # several: one call with all of them

The device acts on a slide joint (or a hinge, for a torsional device) or a tendon; its stretch is the joint's position
less its reference, or the tendon's length less that at qpos0, in m. Needs `pip install mujoco`. With the Euler and
implicit integrators each step is one step of the device; with RK4 its memory also sees the stages between.
"""

import mujoco
from isolator import Isolator


class Device:
    """One device on a joint or a tendon of a model. It holds the state of one simulation (mjData)."""

    def __init__(self, model, joint=None, tendon=None, draw=0, amplitude_m=None):
        if (joint is None) == (tendon is None):
            raise ValueError("name a joint or a tendon, one of them")
        kind = mujoco.mjtObj.mjOBJ_TENDON if joint is None else mujoco.mjtObj.mjOBJ_JOINT
        name = tendon if joint is None else joint
        self.id = mujoco.mj_name2id(model, kind, name)
        if self.id < 0:
            raise ValueError(f"the model has no {'tendon' if joint is None else 'joint'} {name!r}")
        self.on_tendon = joint is None
        allowed = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
        if not self.on_tendon and int(model.jnt_type[self.id]) not in allowed:
            raise ValueError(f"joint {name!r} must be a slide or a hinge")
        self.isolator, self.force_N = Isolator(draw, amplitude_m), 0.0

    def apply(self, model, data):
        """Add the device's force to qfrc_passive."""
        if self.on_tendon:
            stretch, speed = data.ten_length[self.id] - model.tendon_length0[self.id], data.ten_velocity[self.id]
            acceleration = 0.0
        else:
            at, dof = model.jnt_qposadr[self.id], model.jnt_dofadr[self.id]
            stretch, speed, acceleration = data.qpos[at] - model.qpos0[at], data.qvel[dof], data.qacc[dof]
        if data.time < self.isolator.accepted_s:  # the simulation was reset
            self.isolator.start(data.time)
        self.force_N = self.isolator.at(data.time, stretch, speed, acceleration)
        if self.on_tendon:
            first = model.ten_J_rowadr[self.id]
            for k in range(first, first + model.ten_J_rownnz[self.id]):
                data.qfrc_passive[model.ten_J_colind[k]] -= self.force_N * data.ten_J[k]
        else:
            data.qfrc_passive[dof] -= self.force_N


def install(*devices):
    """Let MuJoCo ask these devices at every step; without any, none."""
    if not devices:
        mujoco.set_mjcb_passive(None)
        return

    def passive(model, data):
        for device in devices:
            device.apply(model, data)

    mujoco.set_mjcb_passive(passive)
