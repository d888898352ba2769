"""A policy file holds numbers only, and says so when it is not what it should be."""

import json
import pickle
import zipfile
from itertools import pairwise

import numpy as np
import pytest
from _refusals import refusals

from surefoot.controllers.policy import FORMAT, PolicyFileError, PolicyNetwork
from surefoot.controllers.posture import PostureDrive, posture_matrix

PARTS = {"state": 5, "cop": 2, "cop_valid": 3}


def make(**changes):
    rng = np.random.default_rng(0)
    options = {
        "posture_matrix": posture_matrix(), "posture_speed": 1.5, "posture_memory": 1.0, "hold": 4,
        "dt": 0.0125, "notes": {"seed": 0},
    }  # fmt: skip
    sizes = [10, 6, 4]
    weights = [rng.normal(size=(n, m)) for m, n in pairwise(sizes)]
    biases = [rng.normal(size=n) for n in sizes[1:]]
    return PolicyNetwork(
        changes.pop("parts", PARTS),
        changes.pop("weights", weights),
        changes.pop("biases", biases),
        **(options | changes),
    )


def look(seed=0):
    rng = np.random.default_rng(seed)
    return {"state": rng.normal(size=5), "cop": rng.normal(size=2), "cop_valid": np.ones(3, np.float32)}


def test_a_file_gives_the_same_policy_back(tmp_path):
    policy = make()
    policy.save(tmp_path / "p.npz")
    loaded = PolicyNetwork.load(tmp_path / "p.npz")
    assert loaded.notes == {"seed": 0}
    assert loaded.parts == PARTS
    for seed in range(9):
        np.testing.assert_allclose(loaded(look(seed)), policy(look(seed)), atol=1e-6)
    assert np.abs(policy(look())).max() > 0.0
    loaded.save(tmp_path / "q.npz")
    again = PolicyNetwork.load(tmp_path / "q.npz")
    np.testing.assert_array_equal(again.speeds(look()), loaded.speeds(look()))


def test_it_decides_now_and_then_and_not_before_it_is_engaged():
    policy = make()
    drive = PostureDrive(posture_matrix(), 1.5, 1.0, 0.0125)
    speeds = policy.speeds(look(0))
    for step in range(4):
        np.testing.assert_array_equal(policy(look(step)), drive(speeds))
    np.testing.assert_array_equal(policy(look(4)), drive(policy.speeds(look(4))))
    policy.reset()
    np.testing.assert_array_equal(policy.drive.posture, 0.0)
    waiting = make(engage_after=0.05)
    for step in range(4):
        np.testing.assert_array_equal(waiting(look(step)), 0.0)
    policy.reset()
    np.testing.assert_array_equal(waiting(look(5)), policy(look(5)))


def test_a_posture_is_a_leaky_integral_and_stays_within_its_bounds():
    drive = PostureDrive(posture_matrix(), 1.5, 1.0, 0.0125)
    for _ in range(800):
        drive([1.0, -9.0, 0.1, 0.0])
    np.testing.assert_allclose(drive.posture, [1.0, -1.0, 0.15, 0.0], atol=1e-3)
    for _ in range(800):
        drive(np.zeros(4))
    np.testing.assert_allclose(drive.posture, 0.0, atol=1e-3)
    for changed in ({"speed": 0.0}, {"memory": np.nan}, {"dt": -1.0}, {"matrix": np.ones(3)}):
        with pytest.raises(ValueError, match=f"'{next(iter(changed))}'"):
            PostureDrive(**({"matrix": posture_matrix()} | changed))


def test_it_refuses_another_observation():
    spaces = pytest.importorskip("gymnasium", reason="spaces are Gymnasium's").spaces
    policy = make()
    with pytest.raises(ValueError, match=r"lacks \['cop', 'cop_valid'\].*SelfCalibration"):
        policy({"state": np.zeros(5), "foot_raw": np.zeros(8)})
    policy.reset()
    with pytest.raises(ValueError, match="'state' of 5 numbers, and the observation has 6"):
        policy(look() | {"state": np.zeros(6)})
    box = {
        "state": spaces.Box(-1, 1, (5,)),
        "cop": spaces.Box(-1, 1, (2,)),
        "cop_valid": spaces.Box(0.0, 1.0, (3,)),
    }
    motors = spaces.Box(-1, 1, (11,))
    policy.fits(spaces.Dict(box), motors)
    with pytest.raises(ValueError, match="no 'cop_valid'"):
        policy.fits(spaces.Dict({key: box[key] for key in ("state", "cop")}), motors)
    with pytest.raises(ValueError, match="of 5 numbers, and the environment shows 6"):
        policy.fits(spaces.Dict(box | {"state": spaces.Box(-1, 1, (6,))}), motors)
    with pytest.raises(ValueError, match="moves 11 motors"):
        policy.fits(spaces.Dict(box), spaces.Box(-1, 1, (12,)))


test_it_refuses_what_does_not_fit_together = refusals(
    lambda changes: make(**changes),
    ({"parts": {"state": 4, "cop": 2, "cop_valid": 3}}, "takes 9 numbers"),
    ({"biases": [np.zeros(6)]}, "each layer a weight and a bias"),
    ({"weights": [], "biases": []}, "at least one layer"),
    ({"weights": [np.full((4, 10), np.nan)], "biases": [np.zeros(4)]}, "not finite"),
    ({"weights": [np.zeros((3, 10))], "biases": [np.zeros(3)]}, "3 numbers for 4 postures"),
    ({"posture_speed": -1.0}, "'speed'"),
    ({"hold": 0}, "'hold'"),
    error=PolicyFileError,
)


def contents(path):
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


class Mischief:
    """Runs code when it is unpickled."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('ran')",))


def test_it_refuses_files_of_another_kind(tmp_path):
    make().save(tmp_path / "good.npz")
    good = contents(tmp_path / "good.npz")

    def refused(text, name="bad.npz"):
        with pytest.raises(PolicyFileError, match=text):
            PolicyNetwork.load(tmp_path / name)

    with pytest.raises(FileNotFoundError, match="no policy file"):
        PolicyNetwork.load(tmp_path / "none.npz")
    whole = (tmp_path / "good.npz").read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 30):
        (tmp_path / "bad.npz").write_bytes(whole[:size])
        refused("cannot be read as a policy file")
    broken = bytearray(whole)
    broken[len(whole) // 2] ^= 0xFF
    (tmp_path / "bad.npz").write_bytes(bytes(broken))
    with pytest.raises(PolicyFileError):
        PolicyNetwork.load(tmp_path / "bad.npz")
    (tmp_path / "bad.npz").write_bytes(pickle.dumps(Mischief()))
    refused("cannot be read as a policy file")
    np.savez(tmp_path / "bad.npz", **(good | {"notes": np.array([Mischief()], dtype=object)}))
    refused("cannot be read as a policy file")
    np.savez(tmp_path / "bad.npz", scale=np.ones(8))
    refused("is no policy file: it lacks")
    np.savez(tmp_path / "bad.npz", **(good | {"format": np.array("surefoot-policy-0")}))
    refused(f"this version of surefoot reads '{FORMAT}'")
    np.savez(tmp_path / "bad.npz", **{name: part for name, part in good.items() if name != "bias_1"})
    refused("bias_1")
    np.savez(tmp_path / "bad.npz", **(good | {"extra": np.ones(1)}))
    refused("extra")
    np.savez(tmp_path / "bad.npz", **(good | {"notes": np.array("{")}))
    refused("is damaged")
    for name, value in {
        "hold": np.array(np.inf),
        "sizes": np.array([5.5, 2.0, 2.5]),
        "notes": np.array("[" * 100_000),
        "weight_0": good["weight_0"] * 1j,
        "posture_speed": np.array("fast"),
    }.items():
        np.savez(tmp_path / "bad.npz", **(good | {name: value}))
        refused("is damaged")
    np.savez(tmp_path / "bad.npz", **(good | {"sizes": np.array([12, -4, 2])}))
    refused("at least one number")
    np.savez(tmp_path / "bad.npz", **(good | {"sizes": np.array([4, 2, 3])}))
    refused("bad.npz': Layer 0")
    (tmp_path / "bad.npz").write_bytes(bytes(2**20 + 1))
    refused("cannot be read as a policy file, an archive of arrays .*: File is not a zip file")
    assert json.loads(str(good["notes"])) == {"seed": 0}


def test_whatever_is_damaged_it_is_refused_or_read(tmp_path):
    make().save(tmp_path / "good.npz")
    whole = (tmp_path / "good.npz").read_bytes()
    rng = np.random.default_rng(0)
    refusals = []
    for _ in range(300):
        broken = bytearray(whole)
        for place in rng.integers(len(whole), size=rng.integers(1, 20)):
            broken[place] = rng.integers(256)
        (tmp_path / "bad.npz").write_bytes(bytes(broken))
        try:
            PolicyNetwork.load(tmp_path / "bad.npz")
        except PolicyFileError as error:
            refusals.append(str(error))
    assert len(refusals) > 200
    assert all("bad.npz" in refusal for refusal in refusals)


def test_a_small_file_that_unpacks_to_a_large_one_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", weight_0=np.zeros(2**24))
    assert (tmp_path / "bomb.npz").stat().st_size < 2**20
    with pytest.raises(PolicyFileError, match=r"it unpacks to 134217856 bytes, and 8388608 are the most"):
        PolicyNetwork.load(tmp_path / "bomb.npz")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(PolicyFileError, match=r"cannot be read as a policy file, an archive of arrays"):
        PolicyNetwork.load(tmp_path / "array.npy")


def test_a_stable_baselines_zip_is_not_opened_whatever_it_is_called(tmp_path):
    with zipfile.ZipFile(tmp_path / "model.npz", "w") as archive:
        archive.writestr("data", pickle.dumps(Mischief()))
        archive.writestr("policy.pth", b"")
    with pytest.raises(PolicyFileError, match=r"holds pickled objects.*--trusted"):
        PolicyNetwork.load(tmp_path / "model.npz")
