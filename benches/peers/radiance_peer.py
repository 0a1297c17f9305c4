"""Radiance: `rtrace -I` with its ambient cache."""

import os
import subprocess
import tempfile

import numpy as np
import pyradiance

from timer import Timer

BASE = os.path.dirname(pyradiance.__file__)
ENVIRONMENT = dict(os.environ, RAYPATH=os.path.join(BASE, "lib"))


def tool(name):
    return os.path.join(BASE, "bin", name)


def find_version():
    said = subprocess.run([tool("rtrace"), "-version"], env=ENVIRONMENT, capture_output=True, text=True)
    if said.returncode != 0 or "RADIANCE" not in said.stdout.upper():
        raise ImportError(f"rtrace does not start: {said.stderr.strip()}")
    return said.stdout.strip().split(" lastmod")[0]


VERSION = find_version()
# Frozen, so that `rtrace` need not read the triangles again; 20 triangles a cube take less than half the time of the usual 6 where they
# are many, to build the tree and to trace in it.
OCTREE = [tool("oconv"), "-f", "-n", "20", "-r", "4096"]


def settings_of(budget):
    """Of the ambient cache: with the divisions its interpolation gets finer, as slowly as their noise falls; eight bounces."""
    finer = (128 / budget) ** 0.5
    return {
        "-ab": "8",
        "-ad": str(budget),
        "-as": str(budget // 4),
        "-aa": f"{0.3 * finer:.4f}",
        "-ar": f"{32 / finer:.0f}",
        "-lr": "-10",
        "-lw": f"{0.5 / budget:.3g}",
        "-ds": "0.05",
        "-dt": "0",
        "-dc": "1",
        "-dj": "0.9",
    }


def write_scene(parts, path):
    with open(path, "w", encoding="ascii") as file:
        for i, (_, triangles, albedo, radiance) in enumerate(parts):
            plain = f"0\n0\n5 {numbers(albedo)} 0 0\n"
            if any(radiance):
                # Seen by the ambient calculation as its own diffuse surface, by shadow rays as a light: lights of Radiance are black.
                file.write(f"void plastic m{i}.surface\n{plain}")
                file.write(f"void illum m{i}\n1 m{i}.surface\n0\n3 {numbers(radiance)}\n")
            else:
                file.write(f"void plastic m{i}\n{plain}")
            polygon = f"m{i} polygon p{i}\n0\n0\n9" + 9 * " %.9g" + "\n"
            for some in np.array_split(triangles, len(triangles) // 4096 + 1):
                file.write(len(some) * polygon % tuple(some.ravel()))


def numbers(values):
    return " ".join(f"{value:.9g}" for value in values)


def light(parts, points, normals, budget, threads, _seed, limit):
    """Total and direct irradiance, and the time of octree and total; `budget` ambient divisions."""
    settings = settings_of(budget)
    rays = "".join(numbers(row) + "\n" for row in np.concatenate([points, normals], axis=1))
    with tempfile.TemporaryDirectory() as folder:
        scene, tree = os.path.join(folder, "scene.rad"), os.path.join(folder, "scene.oct")
        write_scene(parts, scene)

        def trace(flags):
            pairs = [part for pair in flags.items() for part in pair]
            command = [tool("rtrace"), "-I", "-h", "-n", str(threads), *pairs, tree]
            said = subprocess.run(
                command, input=rays, env=ENVIRONMENT, capture_output=True, text=True, check=True, timeout=limit
            )
            return np.array(said.stdout.split(), dtype=np.float64).reshape(-1, 3)

        with Timer() as timer:
            with open(tree, "wb") as out:
                subprocess.run([*OCTREE, scene], env=ENVIRONMENT, stdout=out, check=True, timeout=limit)
            total = trace(settings)
        direct = trace(dict(settings, **{"-ab": "0"}))
    return total, direct, timer
