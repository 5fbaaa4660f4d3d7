"""Which library computes with arrays where they are: NumPy and SciPy in the memory of the host, CuPy in a GPU's."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from jaxtyping import Num


@dataclass(frozen=True)
class ArrayLibrary:
    """A library of arrays.

    arrays, fft: modules with NumPy's functions, and with those of `scipy.fft`.
    """

    arrays: Any
    fft: Any

    def taken(self, tensor: Any) -> Any:
        """Return a tensor of Dr.Jit as an array of this library: in a GPU's memory without a copy."""
        return tensor.numpy() if self.arrays is np else self.arrays.from_dlpack(tensor)

    def given(self, array: Num[np.ndarray, "..."]) -> Any:
        """Return an array of the host as one of this library."""
        return self.arrays.asarray(array)

    def fetched(self, array: Any) -> Num[np.ndarray, "..."]:
        """Return an array of this library in the memory of the host."""
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
