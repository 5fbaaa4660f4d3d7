"""Array libraries: NumPy and SciPy for arrays in host memory, CuPy for arrays on a GPU."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from jaxtyping import Num


@dataclass(frozen=True)
class ArrayLibrary:
    """A library of arrays.

    arrays, fft: modules with the interfaces of `numpy` and `scipy.fft`.
    """

    arrays: Any
    fft: Any

    def taken(self, tensor: Any) -> Any:
        """Return a Dr.Jit tensor as an array of this library, on a GPU without a copy."""
        return tensor.numpy() if self.arrays is np else self.arrays.from_dlpack(tensor)

    def given(self, array: Num[np.ndarray, "..."]) -> Any:
        """Return a host array as an array of this library."""
        return self.arrays.asarray(array)

    def fetched(self, array: Any) -> Num[np.ndarray, "..."]:
        """Return an array of this library as a host array."""
        return np.asarray(array) if self.arrays is np else np.asarray(self.arrays.asnumpy(array))


HOST = ArrayLibrary(np, scipy.fft)


def gpu_library() -> ArrayLibrary | None:
    """Return CuPy; None where it is not installed."""
    try:
        import cupy
        import cupyx.scipy.fft
    except ImportError:
        return None
    return ArrayLibrary(cupy, cupyx.scipy.fft)
