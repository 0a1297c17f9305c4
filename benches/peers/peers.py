#!/usr/bin/env python3
"""Irradiance at given points by other renderers: Mitsuba 3 and Radiance, from their Python wheels.

    peers.py --peer mitsuba|radiance --version
    peers.py --peer mitsuba --scene room.glb --points points.csv --out light.csv --budget 256

Prints one JSON document: {"version", "seconds", "processor_seconds"}. The time is that from the converted scene to the irradiance; the
interpreter, its imports and the conversion of the scene are no part of it. A renderer that is not installed is {"absent": why}, a scene
that cannot be handed over truthfully {"refused": why}, a run that took too long {"late": limit}; all with exit code 0.

The scene is the glTF binary that `hplt gen` writes: triangles, flat albedos, area lights that emit from their front. Surfaces reflect
on both sides.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys

PEERS = ["mitsuba", "radiance"]


def main():
    args = parse()
    try:
        peer = importlib.import_module(f"{args.peer}_peer")
    except Exception as problem:  # Whatever keeps a wheel from loading keeps its renderer out of the table.
        print(json.dumps({"absent": f"{type(problem).__name__}: {problem}"}))
        return
    if args.version:
        print(json.dumps({"version": peer.VERSION}))
        return
    from glb import Refused, read_glb

    try:
        parts = read_glb(args.scene)
    except Refused as problem:
        print(json.dumps({"refused": str(problem)}))
        return
    points, normals = read_points(args.points)
    try:
        total, direct, timer = peer.light(parts, points, normals, args.budget, args.threads, args.seed, args.limit)
    except subprocess.TimeoutExpired:
        print(json.dumps({"late": args.limit}))
        return
    write_table(args.out, points, normals, direct, total)
    print(json.dumps({"version": peer.VERSION, "seconds": timer.wall, "processor_seconds": timer.processor}))


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer", choices=PEERS, required=True)
    parser.add_argument("--version", action="store_true", help="say which version is installed, and stop")
    parser.add_argument("--scene", metavar="FILE.glb")
    parser.add_argument("--points", metavar="FILE.csv")
    parser.add_argument("--out", metavar="FILE.csv")
    parser.add_argument("--budget", type=int, default=64, help="Mitsuba: paths per point; Radiance: ambient divisions")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=600, help="seconds")
    args = parser.parse_args()
    if not args.version and None in (args.scene, args.points, args.out):
        parser.error("--scene, --points and --out are needed")
    return args


def read_points(path):
    import numpy as np

    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return table[:, :3], table[:, 3:6]


def write_table(path, points, normals, direct, total):
    import numpy as np

    head = "x,y,z,nx,ny,nz,Ed_r,Ed_g,Ed_b,Ei_r,Ei_g,Ei_b,E_r,E_g,E_b"
    rows = np.concatenate([points, normals, direct, total - direct, total], axis=1)
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")


if __name__ == "__main__":
    sys.exit(main())
