"""Array types, read-only arrays of a checked shape, cross-product matrices.

The trailing axes are those of a vector or matrix; leading axes are samples. All functions accept a
single sample, many samples, and arrays of symbols.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.codec import ArraySchema

Array: TypeAlias = Annotated[NDArray[np.float64], ArraySchema()]
AnyArray: TypeAlias = NDArray[Any]  # of numbers or symbols


def readonly_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> Array:
    """Read-only float64 array of a checked shape.

    Args:
        value: Value that NumPy can convert to an array. It is copied in row-major order unless it
            is already a read-only float64 array, such as a part of a recording or a memory map. An
            empty list becomes an array of the required shape if an axis has length 0 and no axis is
            free.
        shape: Required shape; None leaves an axis free.
        name: Name of the array in the error message.

    Raises:
        ValueError: The shape differs.
    """
    is_readonly = isinstance(value, np.ndarray) and not value.flags.writeable
    array = (
        np.asarray(value, np.float64)
        if is_readonly
        else np.array(value, np.float64, order="C")
    )
    if array.shape == (0,) and 0 in shape and None not in shape:
        # an empty list has one axis
        array = array.reshape([each or 0 for each in shape])
    matches = array.ndim == len(shape) and all(
        length is None or length == actual
        for length, actual in zip(shape, array.shape, strict=True)
    )
    if not matches:
        expected = ", ".join(
            "any" if length is None else str(length) for length in shape
        )
        raise ValueError(f"{name} has shape {array.shape}, expected ({expected})")
    array.flags.writeable = False
    return array


def freeze_arrays(value: object, **shapes: tuple[int | None, ...]) -> None:
    """Replace array fields of a frozen dataclass by read-only arrays, in its `__post_init__`.

    Args:
        value: The dataclass instance, changed in place.
        **shapes: Required shapes as for `readonly_array`, keyed by field name.

    Raises:
        ValueError: A shape differs.
    """
    for name, shape in shapes.items():
        object.__setattr__(
            value, name, readonly_array(getattr(value, name), shape, name)
        )


def skew(v: AnyArray) -> AnyArray:
    """Cross-product matrix v~ with `v~ u = v x u` of a vector v, (..., 3, 3)."""
    matrix = np.zeros((*v.shape, 3), dtype=v.dtype)
    matrix[..., [2, 0, 1], [1, 2, 0]] = v
    matrix[..., [1, 2, 0], [2, 0, 1]] = -v
    return matrix


def multiply_vectors(matrix: AnyArray, vector: AnyArray) -> AnyArray:
    """Products of matrices, (..., 3, 3), with vectors, (..., 3), sample by sample."""
    product: AnyArray = (matrix @ vector[..., None])[..., 0]
    return product
