"""Compile every kernel once, with the types that real runs use.

Numba compiles a kernel when it is first called, which takes two minutes or so for all of them on one core; those that
are listed are compiled beforehand, in a process for each core. The machine code is kept
in `stillroom.compiled.kernel_cache()`: the folder `NUMBA_CACHE_DIR`, by default `stillroom/numba` in the user's cache.
"""

from stillroom.warmup.all_kernels import WarmUp, WarmUpProgress, is_warm, kernels, warm_up

__all__ = ["WarmUp", "WarmUpProgress", "is_warm", "kernels", "warm_up"]
