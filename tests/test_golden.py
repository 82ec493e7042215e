"""Standard scenes end where they always did, after as many iterations: a solver that slowly gets worse is seen here.

`python tests/test_golden.py` runs them all and writes golden.json anew: look at what has changed before it is kept.
"""

import json
import pathlib

import jax
import numpy as np
import pytest
from standard import STANDARD

FILE = pathlib.Path(__file__).with_name("golden.json")
NEAR = 1e-7  # m; more than what the tolerance of a solve leaves, in sums of another order too
BAND = 0.05  # of the iterations, and two more: sums in another order cost or save a trip here and there
QUICK = {("beam of elements", "condensed"), ("sliding box", "direct")}
CASES = [(name, method) for name, each in STANDARD.items() for method in each.methods]


def places(states):
    """Where nodes and centres of rigid bodies are at the end, (n, 3) [m]."""
    last = [states.positions[-1], *([] if states.rigid is None else [states.rigid.positions[-1]])]
    return np.concatenate(last)


@pytest.fixture(scope="module")
def golden():
    return json.loads(FILE.read_text())


@pytest.mark.parametrize(
    ("name", "method"), [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.slow) for case in CASES]
)
def test_ends_and_iterations_are_what_they_were(golden, name, method):
    model, states, infos = STANDARD[name].run(method)
    assert model.method.name == method
    known = golden[name]
    np.testing.assert_allclose(places(states), known["positions"], atol=NEAR)
    found, wanted = int(infos.iterations.sum()), known["iterations"][method]
    assert abs(found - wanted) <= 2 + BAND * wanted, (
        f"{found} iterations, {wanted} before: if that is meant, run this file"
    )


def test_every_case_is_known(golden):
    assert {name: set(each["iterations"]) for name, each in golden.items()} == {
        name: set(each.methods) for name, each in STANDARD.items()
    }


def write():
    """Run every case and write the file; positions are those of each scene's first method."""
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    found = {name: found[name] for name in found if name in STANDARD}
    for name, each in STANDARD.items():
        runs = {method: each.run(method) for method in each.methods}
        first = runs[each.methods[0]][1]
        counts = {method: int(infos.iterations.sum()) for method, (_, _, infos) in runs.items()}
        found[name] = {"iterations": counts, "positions": np.round(places(first), 10).tolist()}
        print(name, counts, flush=True)
        lines = [f"{json.dumps(name)}: {json.dumps(found[name])}" for name in STANDARD if name in found]
        FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    write()
