"""The restricted reader of pickles: what it reads, and that attacks are refused."""

import io
import os
import pickle
import struct
import sys
from collections import OrderedDict
from pathlib import Path
from typing import Any

import fuzzing
import mano_files
import numpy as np
import pytest
from hypothesis import strategies as st
from mano_files import Pickled

from smooth_hand_datasets import unpickle
from smooth_hand_datasets.unpickle import array, load_restricted, numbers, table
from smooth_operator.errors import RecordingError


def load(folder: Path, data: bytes, name: str = "a.pkl") -> Any:
    path = folder / name
    path.write_bytes(data)
    return load_restricted(path)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_of_every_protocol(tmp_path, protocol):
    shared = [1, 2]
    value = {
        "text": "é\u20ac",
        "bytes": b"\x00\xff",
        "numbers": [0, -1, 255, 70_000, -(2**40), 2**70],
        "floats": (1.5, -1e-300),
        "nested": {"a": [shared, shared, None, True, False]},
        3: "int",
        (1, 2): "pair",
        "many": list(range(300)),
        "table": OrderedDict([("a", 1)]),
        "set": {1, 2},
    }
    found = load(tmp_path, pickle.dumps(value, protocol))
    assert found == value
    assert found["nested"]["a"][0] is found["nested"]["a"][1]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_of_every_protocol(tmp_path, protocol):
    rng = np.random.default_rng(0)
    value = {
        "f4": rng.normal(size=(3, 4)).astype(np.float32),
        "fortran": np.asfortranarray(np.eye(3)),
        "big": np.arange(5, dtype=">i4"),
        "bool": np.array([True, False]),
        "none": np.zeros((0, 3)),
        "one": np.float64(2.5),
        "text": np.array(["ab", "é"]),
        "int": np.int32(7),
    }
    found = load(tmp_path, pickle.dumps(value, protocol))
    for name in ("f4", "fortran", "big", "bool", "none"):
        np.testing.assert_array_equal(numbers(found[name]), value[name])
    assert (found["one"], found["int"]) == (2.5, 7)
    assert list(found["text"]) == ["ab", "é"]


def test_files_of_python_2_chumpy_scipy_and_torch(tmp_path):
    rng = np.random.default_rng(0)
    a, dense = rng.normal(size=(4, 5)), rng.normal(size=(3, 6)) * (rng.random((3, 6)) > 0.5)
    value = {
        b"ch": mano_files.Ch(a),
        b"select": mano_files.Select(mano_files.Ch(a), np.array([3, 1]), (2, 1)),
        b"sparse": mano_files.Csc(dense),
        b"tensor": mano_files.Tensor(a),
        b"u\xe9": b"latin",
    }
    found = load(tmp_path, Pickled(3).put(value).done())
    np.testing.assert_array_equal(numbers(found["ch"]), a)
    np.testing.assert_array_equal(numbers(found["select"]), a.ravel()[[3, 1]][:, None])
    np.testing.assert_array_equal(numbers(found["sparse"]), dense)
    np.testing.assert_array_equal(numbers(found["tensor"]), a.astype(np.float32))
    assert found["ué"] == "latin"
    scipy_sparse = pytest.importorskip("scipy.sparse")
    for form in (scipy_sparse.csc_matrix, scipy_sparse.csr_matrix):
        np.testing.assert_array_equal(numbers(load(tmp_path, pickle.dumps(form(dense), 2))), dense)


def test_numpy_files_with_tables_in_them(tmp_path):
    table_ = {"right": {"rot": np.ones((2, 3))}, "name": "box"}
    np.save(tmp_path / "a.npy", table_, allow_pickle=True)
    np.savez(tmp_path / "a.npz", body=table_, plain=np.arange(3))
    np.savez_compressed(tmp_path / "b.npz", list=np.array(["a", {"b": 1}], dtype=object))
    np.testing.assert_array_equal(load_restricted(tmp_path / "a.npy")["right"]["rot"], 1.0)
    found = load_restricted(tmp_path / "a.npz", names=("body", "absent"))
    assert found.keys() == {"body"}
    assert found["body"]["name"] == "box"
    assert load_restricted(tmp_path / "b.npz")["list"] == ["a", {"b": 1}]
    by_hand = load(tmp_path, mano_files.npy_of_object({"x": np.eye(2)}), "c.npy")
    np.testing.assert_array_equal(by_hand["x"], np.eye(2))


def test_messages_name_the_expected_values(tmp_path):
    with pytest.raises(RecordingError, match="f: it lacks poses; it has a, so"):
        table({"a": 1}, "f", ["poses"])
    with pytest.raises(RecordingError, match="a table was expected there, not a list"):
        table([], "f")
    with pytest.raises(RecordingError, match=r"shape \(any, 3\) were expected, not \(2, 4\)"):
        array(np.zeros((2, 4)), "f", (None, 3))
    for value in ({"a": 1}, "text", [["x"]], [[1], [2, 3]], [[[[[1]]]]], None, np.array(["a"])):
        with pytest.raises(RecordingError, match=r"^f"):
            array(value, "f", (None,))


class Evil:
    def __init__(self, *reduced: Any) -> None:
        self.reduced = reduced

    def __reduce__(self) -> Any:
        return self.reduced


def attacks(folder: Path) -> dict[str, bytes]:
    """Pickles that would make the file ``ran`` in a folder, or take memory or time."""
    ran = folder / "ran"
    objects = np.empty(1, dtype=object)
    objects[0] = Evil(os.system, (f"touch {ran}",))
    found = {
        "system": pickle.dumps(Evil(os.system, (f"touch {ran}",)), 2),
        "system0": f"cposix\nsystem\n(S'touch {ran}'\ntR.".encode(),
        "inst": f"(S'touch {ran}'\nios\nsystem\n.".encode(),
        "obj": b"(" + f"cos\nsystem\nS'touch {ran}'\no.".encode(),
        "eval": pickle.dumps(Evil(eval, (f"open({str(ran)!r}, 'w').close()",)), 4),
        "getattr": pickle.dumps(Evil(getattr, ("", "join")), 4),
        "numpy": b"cnumpy\nload\n(S'x'\ntR.",
        "numpy testing": b"cnumpy.testing._private.utils\nrunstring\n(S'1'\n}tR.",
        "dotted": b"\x80\x04\x8c\x05numpy\x8c\x0edtype.__class__\x93.",
        "stack global": b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x01x\x85R.",
        "torch": _tensor((4,), (1,)).replace(b"\x6c\xfc\x9c\x46", b"\x6c\xfc\x9c\x47"),
        "class of chumpy called": b"cchumpy.ch\nsystem\n(S'x'\ntR(dS'a'\nI1\nsb" + b"b.",
        "new object": b"\x80\x02cposix\nsystem\n)\x81.",
        "build of a dict": b"}(S'__class__'\nI1\nud" + b"b.",
        "extension": b"\x80\x02\x82\x01.",
        "persistent": b"Pabc\n.",
        "buffer": b"\x80\x05\x97.",
        "ndarray called": b"cnumpy\nndarray\n(I1000000000\ntR.",
        "array of a class": b"cnumpy.core.multiarray\n_reconstruct\n"
        b"(cbuiltins\nset\n(I0\ntS'b'\ntR.",
        "objects": pickle.dumps(objects, 2),
        "objects in a table": pickle.dumps({"a": np.array([{}, 1], dtype=object)}, 2),
        "fields": pickle.dumps(np.zeros(2, dtype=[("a", "f8")]), 2),
        "dates": pickle.dumps(np.zeros(2, dtype="M8[s]"), 2),
    }
    huge = {
        "bytes": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 40) + b".",
        "text": b"\x80\x04\x8d" + struct.pack("<Q", 1 << 62) + b".",
        "bytearray": b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b".",
        "old bytes": b"\x80\x03B\xff\xff\xff\xff.",
        "old text": b"\x80\x02T\xff\xff\xff\x7f.",
        "negative text": b"\x80\x02T\xff\xff\xff\xff.",
        "frame": b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N.",
        "long": b"\x80\x02\x8b\xff\xff\xff\x7f.",
        "digits": b"I" + b"9" * 5000 + b"\n.",
        "sets": b"\x80\x04" + b"\x8f" * 200_000 + b".",
        "memos": b"\x80\x04N" + b"\x94" * 200_000 + b".",
        "shape": _array_state((1 << 39, 1 << 39), b""),
        "no size": _array_state((1 << 39,), b"", "S0"),
        "stride": _tensor((1_000_000, 1_000_000), (0, 0)),
        "beyond": _tensor((5,), (1 << 38,)),
        "sparse": _sparse((1 << 30, 1 << 30)),
    }
    deep = {
        "deep lists": b"\x80\x02" + b"](" * 100_000 + b"e" * 100_000 + b".",
        "deep tuples": b"\x80\x02)" + b"\x85" * 100_000 + b".",
        "holds itself": b"\x80\x02]q\x00h\x00a.",
        "table holds itself": b"\x80\x02}q\x00K\x01h\x00s.",
        "lists of lists": _doubled(),
    }
    return found | huge | deep


def _array_state(shape: tuple[int, ...], raw: bytes, code: str = "f8") -> bytes:
    out = Pickled().glob("numpy.core.multiarray", "_reconstruct").raw(b"(").glob("numpy", "ndarray")
    out.put((0,)).put(b"b").raw(b"tR(").put(1).put(shape).glob("numpy", "dtype")
    return out.put((code.encode(), 0, 1)).raw(b"R").put(False).put(raw).raw(b"tb").done()


def _tensor(size: tuple[int, ...], stride: tuple[int, ...]) -> bytes:
    data = Pickled(3).put({"a": mano_files.Tensor(np.zeros(4))}).done()
    return _with(data, Pickled().put((4,)).put((1,)), Pickled().put(size).put(stride))


def _sparse(shape: tuple[int, int]) -> bytes:
    data = Pickled().put({"a": mano_files.Csc(np.eye(2))}).done()
    return _with(data, Pickled().put((2, 2)), Pickled().put(shape))


def _with(data: bytes, part: Pickled, other: Pickled) -> bytes:
    """The pickle with other instructions in place of some."""
    plain = part.out.getvalue()[2:]
    assert plain in data
    return data.replace(plain, other.out.getvalue()[2:])


def _doubled() -> bytes:
    """Forty levels of lists that each hold the one below twice: 2^40 numbers."""
    out = Pickled().raw(b"]K\x01aq\x00")
    for _ in range(40):
        out.raw(b"0](h\x00h\x00eq\x00")
    return out.done()


def use(found: Any) -> None:
    """Stand-ins are read when they are wanted, and so refused then."""
    numbers(found["a"] if isinstance(found, dict) and "a" in found else found)


NAMES = sorted(attacks(Path("x")))


@pytest.mark.parametrize("name", NAMES)
def test_an_attack_is_refused(tmp_path, name):
    data = attacks(tmp_path)[name]
    with pytest.raises(RecordingError) as caught:
        use(load(tmp_path, data))
    assert len(str(caught.value)) < 500
    assert not (tmp_path / "ran").exists()
    named = {"system": f"{os.system.__module__}.system", "eval": "builtins.eval"}
    named |= {"numpy": "numpy.load", "stack global": "os.system", "obj": "os.system"}
    if name in named:
        assert f"{named[name]!r}, which is not data" in str(caught.value)


def test_the_reader_imports_nothing_that_a_file_names(tmp_path, monkeypatch):
    (tmp_path / "trap.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    with pytest.raises(RecordingError, match=r"'trap\.x', which is not data"):
        load(tmp_path, b"ctrap\nx\n.")
    assert set(sys.modules) == before
    assert not (tmp_path / "ran").exists()


def test_attacks_within_numpy_files(tmp_path):
    evil = np.empty((), dtype=object)
    evil[()] = Evil(os.system, (f"touch {(tmp_path / 'ran')}",))
    np.save(tmp_path / "a.npy", evil, allow_pickle=True)
    np.savez(tmp_path / "b.npz", a=evil)
    nested = np.empty((), dtype=object)
    nested[()] = {"a": np.array([{}], dtype=object)}
    np.save(tmp_path / "c.npy", nested, allow_pickle=True)
    for name in ("a.npy", "b.npz"):
        with pytest.raises(RecordingError, match="not data"):
            load_restricted(tmp_path / name)
    with pytest.raises(RecordingError, match="array of numbers, not of objects"):
        numbers(load_restricted(tmp_path / "c.npy")["a"])
    assert not (tmp_path / "ran").exists()
    fields = np.zeros(2, dtype=[("a", object)])
    np.save(tmp_path / "d.npy", fields, allow_pickle=True)
    with pytest.raises(RecordingError, match="fields of objects"):
        load_restricted(tmp_path / "d.npy")


def test_a_zip_that_unpacks_to_too_much(tmp_path, monkeypatch):
    monkeypatch.setattr(unpickle, "MOST_BYTES", 1 << 20)
    np.savez_compressed(tmp_path / "a.npz", a=np.array({"x": bytes(8 << 20)}, dtype=object))
    with pytest.raises(RecordingError, match="unpacks to more than"):
        load_restricted(tmp_path / "a.npz")


def test_damaged_and_missing_files(tmp_path):
    for data in (b"", b".", b"N", b"\x80", b"\x80\x09N.", b"hello", b"\x93NUMPY", b"PK\x03\x04xx"):
        with pytest.raises(RecordingError, match=r"a\.pkl: "):
            load(tmp_path, data)
    with pytest.raises(RecordingError, match="No such file"):
        load_restricted(tmp_path / "none.pkl")
    with pytest.raises(RecordingError, match="a folder, not a regular file"):
        load_restricted(tmp_path)


def test_mutants_are_read_or_refused(tmp_path):
    stream = io.BytesIO()
    np.savez(stream, a=np.array({"x": np.eye(2)}, dtype=object), b=np.arange(4.0))
    good = [
        pickle.dumps({"a": np.eye(3), "b": [1, (2.0, "x")], "c": None}, 2),
        pickle.dumps({"a": np.eye(3), "b": [1, (2.0, "x")], "c": None}, 5),
        Pickled(3)
        .put(
            {
                "t": mano_files.Tensor(np.eye(3)),
                "s": mano_files.Csc(np.eye(3)),
                "c": mano_files.Select(mano_files.Ch(np.eye(3)), np.arange(4), (2, 2)),
            }
        )
        .done(),
        mano_files.npy_of_object({"x": np.eye(2)}),
        stream.getvalue(),
    ]
    refused = []

    def read(mutant: bytes) -> None:
        try:
            found = load(tmp_path, mutant)
            for value in found.values() if isinstance(found, dict) else ():
                numbers(value)
        except RecordingError as error:
            refused.append(len(str(error)))

    fuzzing.each(st.one_of(*map(fuzzing.damaged_bytes, good)), 60, read)
    assert len(refused) > 15
    assert max(refused) < fuzzing.LONGEST_MESSAGE
