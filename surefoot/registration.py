"""The environments' names, registered with Gymnasium when surefoot is imported.

Only Gymnasium is imported here: MuJoCo waits until an environment is made.
"""

from gymnasium.envs.registration import register, registry


def register_environments() -> None:
    """Register ``surefoot/...``; doing so again changes nothing."""
    for name, (entry_point, max_episode_steps) in {
        "surefoot/Exercise-v0": ("surefoot.envs.exercise.env:ExerciseEnv", None),
        "surefoot/LegRig-v0": ("surefoot.envs.leg_rig.env:LegRigEnv", 3000),
        "surefoot/NaoBalance-v0": ("surefoot.envs.nao.balance:NaoBalanceEnv", None),
        "surefoot/NaoCarry-v0": ("surefoot.envs.nao.carry:NaoCarryEnv", None),
        "surefoot/NaoStand-v0": ("surefoot.envs.nao.stand:NaoStandEnv", None),
        "surefoot/NaoWalk-v0": ("surefoot.envs.nao.walk:NaoWalkEnv", None),
    }.items():
        if name not in registry:
            register(id=name, entry_point=entry_point, max_episode_steps=max_episode_steps)
