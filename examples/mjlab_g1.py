"""A Unitree G1 of mjlab on drifting load cells, which an observation term calibrates (docs/simulators.md).

    python examples/mjlab_g1.py --robots 2 --steps 300

mjlab asks for another MuJoCo than surefoot's simulations: ``pip install mjlab surefoot`` in an environment of
its own. Without a GPU the first run compiles for some minutes. The robots stand and shake.
"""

import argparse
from functools import cache

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.sensor import ContactMatch, ContactSensorCfg
from mjlab.tasks.registry import load_env_cfg
from mjlab.utils.lab_api.math import matrix_from_quat
from mjlab.utils.noise.noise_cfg import ConstantNoiseCfg, NoiseModelCfg
from mjlab.utils.noise.noise_model import NoiseModel

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, MomentumReference
from surefoot.sensors import preset, sized
from surefoot.wrappers.gpu import FootSensorsModule, SelfCalibrationModule
from surefoot.wrappers.gpu.hooks import noise_model_class, observation_term_class

TASK, DT, MASS, FEET = "Mjlab-Velocity-Flat-Unitree-G1", 0.02, 33.3, ("left", "right")
# Places of the cells in m, about the site of a sole.
CELLS = torch.tensor([(0.08, 0.02), (0.08, -0.02), (-0.08, 0.02), (-0.08, -0.02)])
LAYOUT = FeetLayout(tuple(FootLayout.load_cells(foot, CELLS.numpy()) for foot in FEET))
STIFFER, SHAKE = 8.0, 0.02  # stiffness of its motors, to stand without a policy; size of random actions
ERROR, GROUNDED = 0.003, 0.03  # error in m of its believed centre of mass; height in m of a sole in the air
UPRIGHT = 0.5  # height in m of the centre of mass above the soles of who stands on them; at first it is 0.7


class Robots:
    """The simulator's truth of the robots' feet, and the robots' own beliefs."""

    def __init__(self, env):
        self.env, self.robot = env, env.scene["robot"]
        self.sites, _ = self.robot.find_sites([f"{foot}_foot" for foot in FEET], preserve_order=True)
        masses = env.sim.mj_model.body_mass[self.robot.indexing.body_ids.cpu().numpy()]
        self.share = torch.as_tensor(masses / masses.sum(), dtype=torch.float32, device=env.device)
        # Equal springs under a rigid sole bear (fz, tx, ty) with the least sum of squares.
        x, y = CELLS.T
        self.spread = torch.linalg.pinv(torch.stack([torch.ones(4), y, -x])).to(env.device)

    def soles(self):
        """Return origins (N, 2, 3) and axes (N, 2, 3, 3) of the soles in the world."""
        data = self.robot.data
        return data.site_pos_w[:, self.sites], matrix_from_quat(data.site_quat_w[:, self.sites])

    def force(self):
        """Return the true forces of the cells in N, (N, 8)."""
        contact, (place, axes) = self.env.scene["cells"].data, self.soles()
        force = -contact.force
        torque = torch.linalg.cross(contact.pos - place, force) - contact.torque
        force, torque = (torch.einsum("nfji,nfj->nfi", axes, part) for part in (force, torque))
        wrench = torch.stack([force[..., 2], torque[..., 0], torque[..., 1]], dim=-1)
        return torch.where(contact.found[..., None] > 0, wrench @ self.spread.T, 0.0).flatten(1)

    def beliefs(self):
        """Return the reference: kinematics whose centre of mass is off, and the robots' momentum."""
        data, (place, axes) = self.robot.data, self.soles()
        low = place[..., 2] < GROUNDED
        com = torch.einsum("b,nbi->ni", self.share, data.body_com_pos_w) + ERROR
        # Nothing is learnt from a robot that falls: it rests on more than its soles.
        upright = com[:, 2] - place[..., 2].amin(1) > UPRIGHT
        return MomentumReference(
            com=torch.where(upright[:, None], com, torch.nan),
            com_velocity=torch.einsum("b,nbi->ni", self.share, data.body_com_lin_vel_w),
            angular_momentum=self.env.scene["robot/root_angmom"].data,
            position_sole=place,
            R_level_sole=axes,
            stance=low,
            swing=~low,
        )


def main(robots: int = 2, steps: int = 300, device: str = "cpu") -> tuple[float, float]:
    """Stand; return the rms error of the vertical force in N, by the data sheet and calibrated."""
    feet = FootSensorsModule(sized(preset("hx711-load-cells"), MASS * GRAVITY), robots, device, dt=DT)
    given = {"mass": MASS, "dt": DT, "initial": feet.nominal}
    calibrator = SelfCalibrationModule(LAYOUT, "moment", robots, device, **given)
    watched = cache(Robots)

    def truth(env):
        return watched(env).force()

    def calibrate_feet(env):
        step = env.common_step_counter
        return calibrator(feet(truth(env), step), watched(env).beliefs(), step).force

    class FeetCfg(NoiseModelCfg, class_type=noise_model_class(feet, NoiseModel)): ...

    cfg = load_env_cfg(TASK, play=True)
    cfg.scene.num_envs, cfg.seed = robots, 0
    soles = ContactMatch("subtree", tuple(f"{foot}_ankle_roll_link" for foot in FEET), entity="robot")
    sensor = ContactSensorCfg(
        "cells",
        primary=soles,
        secondary=ContactMatch("body", "terrain"),
        fields=("found", "force", "torque", "pos"),
        reduce="netforce",
    )
    cfg.scene.sensors = (*cfg.scene.sensors, sensor)
    for motor in cfg.scene.entities["robot"].articulation.actuators:
        motor.stiffness, motor.damping = STIFFER * motor.stiffness, STIFFER**0.5 * motor.damping
    terms = {
        "true": ObservationTermCfg(truth),
        "read": ObservationTermCfg(truth, noise=FeetCfg(noise_cfg=ConstantNoiseCfg())),
        "calibrated": ObservationTermCfg(observation_term_class(calibrate_feet, feet, calibrator)),
    }
    cfg.observations["feet"] = ObservationGroupCfg(terms, concatenate_terms=False, enable_corruption=True)
    env = ManagerBasedRlEnv(cfg, device=device)
    feet.counter = lambda: env.common_step_counter
    env.reset()
    chance, errors, falls = torch.Generator(device).manual_seed(0), [], 0
    for _ in range(steps):
        action = torch.empty(robots, env.action_manager.total_action_dim, device=device)
        seen, _, fell, *_ = env.step(action.uniform_(-SHAKE, SHAKE, generator=chance))
        seen, falls = seen["feet"], falls + int(fell.sum())
        calibrator.retract(fell)  # what they learnt as they fell
        errors.append([(seen[name] - seen["true"]).sum(1) for name in ("read", "calibrated")])
    env.close()
    off = torch.stack([torch.stack(pair) for pair in errors[steps // 2 :]])
    before, after = off.square().mean((0, 2)).sqrt().tolist()
    print(
        f"{robots} G1, {steps} steps, {falls} falls: vertical force off by {before:.1f} N by the data sheet, "
        f"{after:.1f} N calibrated"
    )
    return before, after


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--device", default="cpu")
    main(**vars(parser.parse_args()))
