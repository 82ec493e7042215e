"""Soft bodies with lanes last: a chunk of variants as the last, contiguous axis of every array, in one loop.

On a CPU a batch pays where each operation works on many lanes that lie side by side, with arrays that stay in the
cache. `vmap` has lanes first, which XLA's CPU code turns into strided loops. So here a whole step is written with lanes
last, matrix-free, and preconditioned by what all lanes can share: the modes at rest.
"""
