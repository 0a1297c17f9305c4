"""Mitsuba 3: path tracing from the points, compiled by LLVM."""

import subprocess
import time

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
# Fails where LLVM, which the wheel does not bring, is missing.
dr.eval(dr.arange(mi.Float, 4))

from timer import Timer  # noqa: E402

VERSION = f"Mitsuba {mi.__version__}, LLVM"


def light(parts, points, normals, samples, threads, seed, limit):
    """Total and direct irradiance, and their time, by `samples` paths a point: next-event estimation, multiple importance sampling,
    all bounces."""
    dr.set_thread_count(threads)
    shapes = {"type": "scene"}
    for i, (_, triangles, albedo, radiance) in enumerate(parts):
        mesh = mi.Mesh(f"part{i}", 3 * len(triangles), len(triangles), props=properties_of(albedo, radiance))
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(triangles.astype(np.float32).ravel())
        params["faces"] = mi.UInt32(np.arange(3 * len(triangles), dtype=np.uint32))
        params.update()
        shapes[f"part{i}"] = mesh
    with Timer() as timer:
        scene = mi.load_dict(shapes)
        sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
        # As many passes as keep the wavefront below a few million paths.
        n_points = len(points)
        at_once = max(1, min(n_points, (1 << 22) // samples))
        total = np.zeros((n_points, 3))
        direct = np.zeros((n_points, 3))
        for first in range(0, n_points, at_once):
            if first > 0 and time.perf_counter() - timer.wall > limit:
                raise subprocess.TimeoutExpired("mitsuba", limit)
            part = slice(first, min(first + at_once, n_points))
            n = part.stop - part.start
            total[part], direct[part] = one_pass(
                scene, sampler.fork(), points[part], normals[part], n, samples, seed + first
            )
    return total, direct, timer


def properties_of(albedo, radiance):
    props = mi.Properties()
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(albedo)}}
    props["bsdf"] = mi.load_dict({"type": "twosided", "nested": diffuse})
    if any(radiance):
        props["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}})
    return props


def one_pass(scene, sampler, points, normals, n, samples, seed):
    sampler.set_samples_per_wavefront(sampler.sample_count())
    samples = sampler.sample_count()
    sampler.seed(seed, n * samples)
    lane = dr.arange(mi.UInt32, n * samples) // samples
    at = mi.Point3f(*[dr.gather(mi.Float, mi.Float(np.ascontiguousarray(points[:, i])), lane) for i in range(3)])
    up = mi.Normal3f(*[dr.gather(mi.Float, mi.Float(np.ascontiguousarray(normals[:, i])), lane) for i in range(3)])
    total, direct = paths(scene, sampler, at, up)
    return tuple(np.stack([np.array(dr.block_sum(c, samples)) / samples for c in rgb], axis=1) for rgb in (total, direct))


@dr.syntax
def paths(scene, sampler, at, up):
    # The receiver is a white diffuse surface without emission: radiance that it would scatter, times pi, is irradiance.
    weight = mi.Color3f(dr.pi)
    total, direct = mi.Color3f(0.0), mi.Color3f(0.0)
    depth, active = mi.UInt32(0), mi.Bool(True)
    while active:
        # What the loop carries is kept small: a point and the normal on the side that the light comes from.
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.n, si.sh_frame = at, up, mi.Frame3f(up)
        # Light sampled at the emitters...
        ds, radiance = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
        cosine = dr.dot(ds.d, up)
        lit = active & (cosine > 0.0) & (ds.pdf > 0.0)
        lit &= ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
        share = ds.pdf / (ds.pdf + cosine / dr.pi)
        found = dr.select(lit, weight * radiance * (cosine / dr.pi * share), 0.0)
        # ... and where a ray goes on, weighted so that the two count once.
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        ray = si.spawn_ray(si.sh_frame.to_world(local))
        pdf = local.z / dr.pi
        hit = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
        is_front = dr.dot(hit.n, ray.d) < 0.0
        emitter = hit.emitter(scene, active)
        seen = active & hit.is_valid() & (emitter != None) & is_front  # noqa: E711
        hit.sh_frame.n = hit.n
        hit.wi = hit.to_local(-ray.d)
        pdf_light = scene.pdf_emitter_direction(si, mi.DirectionSample3f(scene, hit, si), seen)
        found += dr.select(seen, weight * emitter.eval(hit, seen) * (pdf / (pdf + pdf_light)), 0.0)
        total += found
        direct += dr.select(depth == 0, found, 0.0)
        active &= hit.is_valid()
        weight *= dr.select(active, hit.bsdf().eval_diffuse_reflectance(hit, active), 1.0)
        at, up = hit.p, dr.select(is_front, hit.n, -hit.n)
        depth += 1
        survival = dr.select(depth < 4, 1.0, dr.minimum(dr.max(weight) / dr.pi, 0.95))
        active &= sampler.next_1d(active) < survival
        weight /= dr.maximum(survival, 1e-6)
    return total, direct
