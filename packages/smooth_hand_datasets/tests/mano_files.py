"""A hand with the arrays and shapes of MANO's model files, made up, and writers of such files.

The pickles are written by hand, instruction by instruction, as Python 2, chumpy, SciPy and PyTorch
write them: none of these is needed, and nothing of the reader is used. ``reference_landmarks``
computes the 21 landmarks vertex by vertex with homogeneous matrices, in loops.
"""

import io
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

JOINTS = 16
VERTICES = 778
TIPS = {
    ("smplx", "right"): (744, 320, 443, 554, 671),
    ("smplx", "left"): (744, 320, 443, 554, 671),
    ("manopth", "right"): (745, 317, 444, 556, 673),
    ("manopth", "left"): (745, 317, 445, 556, 673),
}
PARENT = {1: 0, 2: 1, 3: 2, 4: 0, 5: 4, 6: 5, 7: 0, 8: 7, 9: 8, 10: 0, 11: 10, 12: 11}
PARENT |= {13: 0, 14: 13, 15: 14}
# Our landmark -> the joint, or the number of the tip, in MANO's order of joints and tips.
ORDER = (0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20)

# Joints of a right hand [m]: fingers to -x, thumb to z, the back to y.
_RIGHT = np.array(
    [
        [0.095, 0.006, 0.006],
        [0.007, 0.010, 0.027],
        [-0.025, 0.009, 0.031],
        [-0.048, 0.006, 0.033],
        [0.001, 0.011, 0.004],
        [-0.032, 0.011, 0.004],
        [-0.060, 0.008, 0.004],
        [0.027, 0.005, -0.034],
        [0.007, 0.003, -0.043],
        [-0.011, 0.001, -0.050],
        [0.013, 0.009, -0.016],
        [-0.017, 0.009, -0.021],
        [-0.044, 0.006, -0.025],
        [0.070, -0.010, 0.035],
        [0.050, -0.016, 0.056],
        [0.029, -0.021, 0.070],
    ]
)
_TIP_OFFSETS = (
    (-0.024, -0.004, 0.012),
    (-0.023, -0.004, 0.001),
    (-0.024, -0.004, 0.0),
    (-0.023, -0.004, -0.003),
    (-0.020, -0.003, -0.005),
)
_LAST = (15, 3, 6, 12, 9)  # joints before the tips of thumb, index, middle, ring, pinky


def model_arrays(side: str, seed: int = 0) -> dict[str, np.ndarray]:
    """The arrays of a made-up model; a left hand's shape directions have the right one's x, as
    published. ``seed`` is that of its blend shapes."""
    rng = np.random.default_rng(seed)
    flip = np.array([1.0 if side == "right" else -1.0, 1.0, 1.0])
    joints = _RIGHT
    template = rng.normal(size=(VERTICES, 3)) * 0.004
    owner = np.arange(VERTICES) % JOINTS
    template += joints[owner]
    weights = np.zeros((VERTICES, JOINTS))
    for vertex in range(VERTICES):
        first = int(owner[vertex])
        share = rng.uniform(0.5, 1.0)
        weights[vertex, first] = share
        weights[vertex, PARENT.get(first, 0)] += 1.0 - share
    for ids in TIPS.values():
        for tip, vertex in enumerate(ids):
            last = _LAST[tip]
            template[vertex] = joints[last] + _TIP_OFFSETS[tip] + rng.normal(size=3) * 0.0005
            weights[vertex] = 0.0
            weights[vertex, last], weights[vertex, PARENT[last]] = 0.9, 0.1
    # Rows that give exactly these joints: each is the mean of its vertices, the last one adjusted.
    regressor = np.zeros((JOINTS, VERTICES))
    tips = {vertex for ids in TIPS.values() for vertex in ids}
    for joint in range(JOINTS):
        own = [v for v in range(VERTICES) if owner[v] == joint and v not in tips]
        regressor[joint, own] = 1.0 / len(own)
        template[own] += joints[joint] - template[own].mean(axis=0)
    shapes = rng.normal(size=(VERTICES, 3, 10)) * 0.0004
    shapes[:, :, 0] += 0.03 * (template - joints[4])
    poses_ = rng.normal(size=(VERTICES, 3, 135)) * 0.0002
    components = np.linalg.qr(rng.normal(size=(45, 45)))[0]
    mean = np.tile([0.0, 0.0, 0.25], 15) + 0.02 * rng.normal(size=45)
    if side == "left":
        signs = np.tile(np.outer(flip, flip).ravel(), 15)  # of a mirrored rotation's entries
        poses_ = poses_ * flip[:, None] * signs
        mean = (mean.reshape(15, 3) * [1.0, -1.0, -1.0]).ravel()
        components = (components.reshape(45, 15, 3) * [1.0, -1.0, -1.0]).reshape(45, 45)
    tree = np.array([[4294967295, *(PARENT[j] for j in range(1, JOINTS))], list(range(JOINTS))])
    return {
        "v_template": template * flip,
        "shapedirs": shapes,
        "posedirs": poses_,
        "J_regressor": regressor,
        "weights": weights,
        "hands_components": components,
        "hands_mean": mean,
        "kintree_table": tree.astype(np.uint32),
        "f": rng.integers(0, VERTICES, (1538, 3)).astype(np.uint32),
        "J": joints * flip,
        "hands_coeffs": rng.normal(size=(3, 45)),
    }


def reference_landmarks(
    arrays: dict[str, np.ndarray],
    side: str,
    root: np.ndarray,
    pose: np.ndarray,
    betas: np.ndarray,
    translation: np.ndarray,
    tips: str = "smplx",
    about_wrist: bool = False,
) -> np.ndarray:
    """(21, 3) of one frame: 16 axis-angle rotations, homogeneous matrices, all vertices in loops.

    Args:
        root: (3,) and
        pose: (45,) axis times angle, the mean pose already added.
    """
    vectors = [root, *np.reshape(pose, (15, 3))]
    turns = [_rodrigues(vector) for vector in vectors]
    shaped = arrays["v_template"].copy()
    for number in range(10):
        shaped = shaped + betas[number] * arrays["shapedirs"][:, :, number]
    joints = [
        sum(
            arrays["J_regressor"][j, v] * shaped[v]
            for v in range(VERTICES)
            if arrays["J_regressor"][j, v]
        )
        for j in range(JOINTS)
    ]
    features = np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    placed: list[np.ndarray] = []
    for joint in range(JOINTS):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        local[:3, 3] = joints[joint] - (joints[PARENT[joint]] if joint else 0)
        placed.append(local if not joint else placed[PARENT[joint]] @ local)
    points = [matrix[:3, 3] for matrix in placed]
    for vertex in TIPS[tips, side]:
        bent = [arrays["posedirs"][vertex, k] @ features for k in range(3)]
        rest = shaped[vertex] + np.array(bent)
        blend = np.zeros((4, 4))
        for joint in range(JOINTS):
            back = np.eye(4)
            back[:3, 3] = -joints[joint]
            blend += arrays["weights"][vertex, joint] * (placed[joint] @ back)
        points.append((blend @ [*rest, 1.0])[:3])
    shift = translation - (points[0] if about_wrist else 0)
    return np.array([points[i] + shift for i in ORDER])


def _rodrigues(vector: np.ndarray) -> np.ndarray:
    """By the exponential series of the cross product's matrix."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    total, term = np.eye(3), np.eye(3)
    for n in range(1, 40):
        term = term @ cross / n
        total = total + term
    return total


# --- pickles by hand ---------------------------------------------------------------------------


class Pickled:
    """Writes instructions of protocol 2, as Python 2's cPickle does for these objects."""

    def __init__(self, protocol: int = 2) -> None:
        self.out = io.BytesIO()
        self.out.write(b"\x80" + bytes([protocol]))

    def done(self) -> bytes:
        return self.out.getvalue() + b"."

    def raw(self, code: bytes) -> "Pickled":
        self.out.write(code)
        return self

    def glob(self, module: str, name: str) -> "Pickled":
        return self.raw(b"c" + module.encode() + b"\n" + name.encode() + b"\n")

    def put(self, value: Any) -> "Pickled":
        """A plain value, an array, or an object with ``pickle_into``."""
        if hasattr(value, "pickle_into"):
            value.pickle_into(self)
        elif isinstance(value, np.ndarray):
            self.array(value)
        elif value is None:
            self.raw(b"N")
        elif isinstance(value, bool | np.bool_):
            self.raw(b"\x88" if value else b"\x89")
        elif isinstance(value, int | np.integer):
            self.integer(int(value))
        elif isinstance(value, float):
            self.raw(b"G" + struct.pack(">d", value))
        elif isinstance(value, str):
            data = value.encode()
            self.raw(b"X" + struct.pack("<I", len(data)) + data)
        elif isinstance(value, bytes):
            self.raw(b"T" + struct.pack("<i", len(value)) + value)
        elif isinstance(value, dict):
            self.raw(b"}(")
            for key, item in value.items():
                self.put(key).put(item)
            self.raw(b"u")
        elif isinstance(value, list):
            self.raw(b"](")
            for item in value:
                self.put(item)
            self.raw(b"e")
        elif isinstance(value, tuple):
            self.raw(b"(")
            for item in value:
                self.put(item)
            self.raw(b"t")
        else:
            raise TypeError(type(value))
        return self

    def integer(self, value: int) -> None:
        if 0 <= value < 256:
            self.raw(b"K" + bytes([value]))
        elif -(2**31) <= value < 2**31:
            self.raw(b"J" + struct.pack("<i", value))
        else:
            data = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
            self.raw(b"\x8a" + bytes([len(data)]) + data)

    def dtype(self, dtype: np.dtype[Any]) -> "Pickled":
        code = dtype.str[1:]
        self.glob("numpy", "dtype").put((code.encode(), 0, 1)).raw(b"R")
        return self.put((3, dtype.str[:1].encode(), None, None, None, -1, -1, 0)).raw(b"b")

    def array(self, array: np.ndarray) -> None:
        self.glob("numpy.core.multiarray", "_reconstruct").raw(b"(").glob("numpy", "ndarray")
        self.put((0,)).put(b"b").raw(b"tR")
        self.raw(b"(").put(1).put(tuple(array.shape)).dtype(array.dtype)
        self.put(False).put(np.ascontiguousarray(array).tobytes()).raw(b"tb")


def _reconstructed(out: Pickled, module: str, name: str) -> None:
    """An object as ``copy_reg`` writes it; its state follows."""
    out.glob("copy_reg", "_reconstructor").raw(b"(").glob(module, name)
    out.glob("__builtin__", "object").put(None).raw(b"tR")


class Ch:
    """``chumpy.ch.Ch``, an array."""

    def __init__(self, array: np.ndarray) -> None:
        self.x = array

    def pickle_into(self, out: Pickled) -> None:
        _reconstructed(out, "chumpy.ch", "Ch")
        out.raw(b"}(").put(b"_dirty_vars").glob("__builtin__", "set").put(([],)).raw(b"R")
        out.put(b"_itr").put(None).put(b"x").put(self.x).raw(b"ub")


class Select(Ch):
    """``chumpy.reordering.Select``: some numbers of an array, in a shape."""

    def __init__(self, a: Ch, idxs: np.ndarray, shape: tuple[int, ...]) -> None:
        self.state = {b"preferred_shape": shape, b"a": a, b"idxs": idxs}

    def pickle_into(self, out: Pickled) -> None:
        _reconstructed(out, "chumpy.reordering", "Select")
        out.put(self.state).raw(b"b")


class Csc:
    """``scipy.sparse.csc.csc_matrix``."""

    def __init__(self, dense: np.ndarray) -> None:
        columns, rows = np.nonzero(dense.T)
        ends = np.searchsorted(columns, np.arange(dense.shape[1] + 1))
        self.state = {
            b"_shape": dense.shape,
            b"maxprint": 50,
            b"data": dense[rows, columns],
            b"indices": rows.astype(np.int32),
            b"indptr": ends.astype(np.int32),
        }

    def pickle_into(self, out: Pickled) -> None:
        _reconstructed(out, "scipy.sparse.csc", "csc_matrix")
        out.put(self.state).raw(b"b")


class Tensor:
    """A tensor of PyTorch in a plain pickle: its storage is a text of ``torch.save``'s old form."""

    def __init__(self, array: np.ndarray) -> None:
        with np.errstate(over="ignore"):
            self.array = np.ascontiguousarray(array, np.float32)

    def pickle_into(self, out: Pickled) -> None:
        count = self.array.size
        identifier = Pickled().raw(b"(").put("storage").glob("torch", "FloatStorage")
        identifier.put("94317").put("cpu").put(count).put(None).raw(b"tQ")
        sizes = {"short": 2, "int": 4, "long": 4}
        about = {"protocol_version": 1001, "little_endian": True, "type_sizes": sizes}
        parts = [
            Pickled().put(0x1950A86A20F9469CFC6C).done(),
            Pickled().put(1001).done(),
            Pickled().put(about).done(),
            identifier.done(),
            Pickled().put(["94317"]).done(),
            struct.pack("<q", count),
            self.array.astype("<f4").tobytes(),
        ]
        data = b"".join(parts)
        out.glob("torch._utils", "_rebuild_tensor_v2").raw(b"(")
        out.glob("torch.storage", "_load_from_bytes")
        out.raw(b"(B" + struct.pack("<I", len(data)) + data + b"tR").put(0)
        strides, step = [], 1
        for length in reversed(self.array.shape):
            strides.insert(0, step)
            step *= length
        out.put(tuple(self.array.shape)).put(tuple(strides)).put(False)
        out.glob("collections", "OrderedDict").raw(b")RtR")


def pickled(value: Any) -> bytes:
    """A pickle of protocol 3."""
    return Pickled(3).put(value).done()


def npy_of_object(value: Any) -> bytes:
    """A ``.npy`` of an array of one object, as ``numpy.save`` writes a dictionary."""
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }".ljust(117) + b"\n"
    out = Pickled(3).glob("numpy.core.multiarray", "_reconstruct").raw(b"(")
    out.glob("numpy", "ndarray").put((0,)).put(b"b").raw(b"tR(").put(1).put(()).glob(
        "numpy", "dtype"
    )
    out.put((b"O8", 0, 1)).raw(b"R").put((3, b"|", None, None, None, -1, -1, 63)).raw(b"b")
    out.put(False).put([value]).raw(b"tb")
    return b"\x93NUMPY\x01\x00v\x00" + header + out.done()


def model_pickle(arrays: dict[str, np.ndarray]) -> bytes:
    """The model as a pickle of Python 2, with chumpy's and SciPy's objects in it."""
    shapes = arrays["shapedirs"]
    wide = np.concatenate([shapes, 9.0 + np.zeros((VERTICES, 3, 3))], axis=2)
    kept = np.arange(wide.size).reshape(wide.shape)[:, :, :10].ravel()
    held: dict[bytes, Any] = {key.encode(): value for key, value in arrays.items()}
    held[b"shapedirs"] = Select(Ch(wide), kept, shapes.shape)
    held[b"posedirs"] = arrays["posedirs"]
    held[b"v_template"] = Ch(arrays["v_template"])
    held[b"J_regressor"] = Csc(arrays["J_regressor"])
    held[b"bs_type"], held[b"bs_style"] = b"lrotmin", b"lbs"
    return Pickled().put(held).done()


def write_models(folder: Path, *, seed: int = 0) -> dict[str, dict[str, np.ndarray]]:
    """Both hands' model files in a folder; their arrays by side."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for side in ("right", "left"):
        found[side] = model_arrays(side, seed)
        (folder / f"MANO_{side.upper()}.pkl").write_bytes(model_pickle(found[side]))
    return found


def poses_of(side: str, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(T, 45) axis times angle of bending fingers, and (T, 3) of a turning hand."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 2 * math.pi, count)[:, None] + rng.uniform(0, 6, 15)
    pose = np.zeros((count, 15, 3))
    pose[:, :, 2] = 0.35 + 0.3 * np.sin(phase)
    pose[:, :, 1] = 0.03 * np.sin(phase)
    root = np.cumsum(rng.normal(size=(count, 3)) * 0.02, axis=0) + rng.normal(size=3)
    if side == "left":
        pose[:, :, 1:] *= -1.0
    return pose.reshape(count, 45), root
