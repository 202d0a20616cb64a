"""Arrays as values: read-only, of a checked shape; and the two matrices every room needs.

Trailing axes are the vector's or matrix's own, leading axes are samples, so that every
function here serves one sample, many samples, and arrays of symbols alike.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.codec import ArraySchema

Array: TypeAlias = Annotated[NDArray[np.float64], ArraySchema()]
AnyArray: TypeAlias = NDArray[Any]  # numbers or symbols


def readonly(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> Array:
    """`value` as a read-only array of float64, checked to have `shape`.

    Args:
        value: Anything NumPy turns into an array. Copied, row by row, unless it is one of
            float64 that is read-only already: parts of recordings and memory maps stay where
            they are.
        shape: Required shape; None leaves an axis free.
        name: What the array is called in the error.

    Raises:
        ValueError: The shape differs.
    """
    kept = isinstance(value, np.ndarray) and not value.flags.writeable
    array = (
        np.asarray(value, np.float64)
        if kept
        else np.array(value, np.float64, order="C")
    )
    if array.shape == (0,) and 0 in shape and None not in shape:
        # a list of nothing has one axis
        array = array.reshape([each or 0 for each in shape])
    fits = array.ndim == len(shape) and all(
        want is None or want == have
        for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} has shape {array.shape}, expected ({wanted})")
    array.flags.writeable = False
    return array


def freeze(value: object, **shapes: tuple[int | None, ...]) -> None:
    """Arrays of a frozen value made read-only, as it is made; for `__post_init__`.

    Args:
        value: The value.
        shapes: By the array's name, as for `readonly`.

    Raises:
        ValueError: A shape differs.
    """
    for name, shape in shapes.items():
        object.__setattr__(value, name, readonly(getattr(value, name), shape, name))


def skew(v: AnyArray) -> AnyArray:
    """The matrix v~ with v~ u = v x u.  v: (..., 3); returns (..., 3, 3)."""
    found = np.zeros((*v.shape, 3), dtype=v.dtype)
    found[..., [2, 0, 1], [1, 2, 0]] = v
    found[..., [1, 2, 0], [2, 0, 1]] = -v
    return found


def apply(matrix: AnyArray, vector: AnyArray) -> AnyArray:
    """Matrix times vector.  (..., 3, 3) and (..., 3) give (..., 3)."""
    product: AnyArray = (matrix @ vector[..., None])[..., 0]
    return product
