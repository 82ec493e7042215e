"""Cases that other engines are asked, with the same numbers and limits as ours, and what they have in common.

An engine is a module with `NAME`, `VERSION`, `STEPS` (name -> step [s]: that of our own cases, and what its own
documentation takes) and `CASES` (name of a case -> function of the step that returns (wanted, flags)).
"""

import numpy as np
from hard.wanted import Wanted

SIDE, G = 0.1, 9.81
TIMES = {"free": 10 / 3, "slope": 1.0, "chain": 2.0, "tumble": 10_000 / 60}  # s, as in our cases
BAD_START = {
    "flattened": lambda x: x * (1, 1, 0),
    "mirrored": lambda x: x * (-1, 1, 1) + 1e-3 * SIDE * np.random.default_rng(0).standard_normal(x.shape),
    "inside out": lambda x: -x,
    "line": lambda x: x * (1, 0, 0),
    "point": lambda x: x * 0,
    "random": lambda x: np.random.default_rng(0).uniform(-SIDE / 2, SIDE / 2, x.shape),
    "scaled 0.01": lambda x: x * 0.01,
    "scaled 10": lambda x: x * 10,
}
CHAINS = {
    "chain of 1 g links with 1 kg": (1.0, G),
    "chain of 1 g links with 100 kg": (100.0, G),
    "chain of 1 g links with 1000 kg": (1000.0, G),
    "chain of 1 g links with 1 kg at g = 1e4": (1.0, 1e4),
}
SLOPES = {  # degrees, friction, direction [degrees from x]
    "slope of 20 degrees, friction 0.5: holds": (20, 0.5, 0),
    "slope of 35 degrees, friction 0.5: slides": (35, 0.5, 0),
    "slope of 30 degrees along the diagonal, friction 0.5: slides": (30, 0.5, 45),
    "slope of 40 degrees, friction 10: holds": (40, 10.0, 0),
    "slope of 40 degrees, friction 1e6: holds": (40, 1e6, 0),
}


def cells(count: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of a cube of side SIDE about the origin and tetrahedra (five a cell, alternating)."""
    line = np.linspace(-SIDE / 2, SIDE / 2, count + 1)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(points)).reshape((count + 1,) * 3)
    even = [(0, 1, 3, 5), (0, 3, 2, 6), (0, 5, 4, 6), (3, 5, 6, 7), (0, 3, 5, 6)]
    found = []
    for i, j, k in np.ndindex((count,) * 3):
        corner = [number[i + a, j + b, k + c] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
        order = corner if (i + j + k) % 2 == 0 else [corner[n ^ 1] for n in range(8)]
        found += [[order[n] for n in tet] for tet in even]
    made = np.array(found)
    volume = np.linalg.det(points[made[:, 1:]] - points[made[:, :1]])
    made[volume < 0] = made[volume < 0][:, [0, 1, 3, 2]]
    return points, made


def recovery(rest: np.ndarray, places: np.ndarray) -> float:
    """Distance from the undeformed shape, turned and moved as fits best, over SIDE (root mean square)."""
    if not np.isfinite(places).all():
        return float("nan")
    a, b = rest - rest.mean(0), places - places.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    return float(np.sqrt(((a @ turn - b) ** 2).sum(1).mean()) / SIDE)


def slid(moved: np.ndarray, degrees: float, friction: float, towards: float, duration: float) -> list[Wanted]:
    """What is wanted of a box on a slope that has `moved` (3,) [m] from rest."""
    a, b = np.radians(degrees), np.radians(towards)
    right = G * max(0.0, np.sin(a) - friction * np.cos(a))
    found = 2 * float(moved @ (np.cos(b), np.sin(b), 0)) / duration**2
    return [Wanted("error of the acceleration [m/s^2]", abs(found - right), 0.03 * G)]


def pull(degrees: float, towards: float, size: float = G) -> np.ndarray:
    """Gravity turned instead of the ground (3,) [m/s^2]."""
    a, b = np.radians(degrees), np.radians(towards)
    return size * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)])
