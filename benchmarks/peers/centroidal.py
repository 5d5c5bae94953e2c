"""Static equilibrium by hpp-centroidal-dynamics, the LAAS library for robots in contact with their surroundings.

    python -m benchmarks.peers.centroidal CONTACTS.npz VERDICTS.npy

Its friction cones are pyramids inscribed in the true ones, its forces have no greatest, and gravity is along -z. It
runs in a process of its own, because it brings solvers that are not to be mixed with Drake's.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PACKAGE = "hpp-centroidal-dynamics"
EDGES = 16


def available() -> bool:
    """Whether the package is installed; it comes with the extra `bench`."""
    try:
        distribution(PACKAGE)
    except PackageNotFoundError:
        return False
    return True


def equilibria(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    friction: NDArray[np.float64],
    centers: NDArray[np.float64],
    mass: float,
) -> tuple[NDArray[np.float64], float]:
    """What the package says of M sets of k contacts.

    Args:
        points: Contact points [m], shape (M, k, 3).
        normals: Unit normals, shape (M, k, 3).
        friction: One coefficient for all contacts of a set, shape (M,).
        centers: Centres of mass asked about [m], shape (M, 3).
        mass: [kg]

    Returns:
        Its robustness of the equilibria, positive where there is one, shape (M,), and the time it took [s].
    """
    prefix = Path(str(distribution(PACKAGE).locate_file("cmeel.prefix")))
    libraries = os.pathsep.join(str(prefix / name) for name in ("lib", "lib64"))
    environment = {**os.environ, "LD_LIBRARY_PATH": libraries, "DYLD_LIBRARY_PATH": libraries}
    with tempfile.TemporaryDirectory() as folder:
        given, answer = Path(folder) / "contacts.npz", Path(folder) / "verdicts.npy"
        np.savez(given, points=points, normals=normals, friction=friction, centers=centers, mass=mass)
        command = [sys.executable, __file__, str(given), str(answer)]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        *robustness, seconds = np.load(answer)
    return np.array(robustness), float(seconds)


def _run(given: str, answer: str) -> None:
    import time

    import hpp_centroidal_dynamics as hpp

    data = np.load(given)
    program = hpp.Equilibrium("peer", float(data["mass"]), EDGES, hpp.SOLVER_LP_CLP, True, 1000, False)
    robustness, began = [], time.perf_counter()
    for points, normals, friction, center in zip(
        data["points"], data["normals"], data["friction"], data["centers"], strict=True
    ):
        program.setNewContacts(
            np.asfortranarray(points), np.asfortranarray(normals), float(friction), hpp.EQUILIBRIUM_ALGORITHM_LP
        )
        status, value = program.computeEquilibriumRobustness(center)
        robustness.append(float(value) if status == hpp.LP_STATUS_OPTIMAL else -np.inf)
    np.save(answer, [*robustness, time.perf_counter() - began])


if __name__ == "__main__":
    _run(*sys.argv[1:])
