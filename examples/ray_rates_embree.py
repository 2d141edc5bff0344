"""Embree's rates for the rays that `ray_rates.rs` wrote: python ray_rates_embree.py rays.bin (needs numpy and embreex).

One thread, all rays of a kind in one call as embreex offers it; process time, best of five; what embreex itself does around each ray counts."""
import sys
import time

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

with open(sys.argv[1], "rb") as file:
    counts = np.fromfile(file, "<u4", 4)
    triangles = np.fromfile(file, "<f4", 9 * counts[0]).reshape(-1, 3, 3)
    rays = [np.fromfile(file, "<f4", 7 * n).reshape(-1, 7) for n in counts[1:]]
scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, triangles)
print("million rays a second of one thread")
for kind, ray in zip(("primary", "bounce", "shadow"), rays):
    origins, directions = np.ascontiguousarray(ray[:, :3]), np.ascontiguousarray(ray[:, 3:6])
    lengths = np.minimum(ray[:, 6], np.float32(1e37))
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        if kind == "shadow":
            scene.run(origins, directions, dists=lengths.copy(), query="OCCLUDED")
        else:
            scene.run(origins, directions, query="INTERSECT")
        best = min(best, time.process_time() - begin)
    print(kind, round(len(ray) / best * 1e-6, 1))
