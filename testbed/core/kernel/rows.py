"""Regressor rows at samples: joint coordinates, motions of bodies, and row entries.

Each component of a quantity is stored in a slot: an array with one number per sample. The slots of
body motions X, screws V and joint coordinates U are B numbers apart, the slots of the rows Y are D
numbers apart. P is the motion or the screw of the carrier, J holds the constants of a link: cosine
and sine of the twist angle about x, offset, angle about z, and its cosine and sine. Canonical
frames need rotations about z and x only. A row has one entry per parameter of the body.
"""

from __future__ import annotations

from testbed.core.kernel.compiler import (
    compiled_function,
    inline_sum,
    llvm_inline,
    numba_inline,
)
from testbed.core.kernel.records import (
    COSINE_COEFFICIENTS,
    NB,
    PER_PI,
    PI_PARTS,
    ROUNDING_SHIFT,
    SINE_COEFFICIENTS,
    B,
    D,
)
from testbed.core.robot.friction import JOINT_LAWS

# Offsets of the slots in a body's motion.
C, S = 0, B  # cosine and sine of the joint's angle
Z, ZZ = 2 * B, 3 * B  # displacement along z, its absolute second derivative
W, E, A = 6 * B, 9 * B, 12 * B  # angular velocity, its rate, acceleration less gravity
O = 15 * B  # matrix wd~ + w~ w~, row by row
BODY_SIZE = 24 * B  # size of a body's motion

# size of a screw: angular part u, linear part v at the body's origin
SCREW_SIZE = 6 * B


@llvm_inline
def vector(X, at, k):
    """Vector at sample k, read from three consecutive component arrays that start at `at`."""
    return X[at + k], X[at + B + k], X[at + 2 * B + k]


@llvm_inline
def write_vector(X, at, k, v):
    """Write a vector at sample k to three consecutive component arrays that start at `at`."""
    X[at + k], X[at + B + k], X[at + 2 * B + k] = v


@llvm_inline
def acceleration_matrix(X, k):
    """Rows of the matrix wd~ + w~ w~ of a body at sample k."""
    return vector(X, O, k), vector(X, O + 3 * B, k), vector(X, O + 6 * B, k)


@llvm_inline
def add_vectors(a, b):
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@llvm_inline
def cross(a, b):
    """Cross product of two vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@llvm_inline
def inner(a, b):
    """Inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@llvm_inline
def matrix_column(o, i):
    """Column i of a matrix given by rows."""
    return o[0][i], o[1][i], o[2][i]


@llvm_inline
def rotate_z(c, s, v):
    """Components of v after a rotation of the frame about z (cosine c, sine s)."""
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


@llvm_inline
def sine_cosine(q, shift, s, c):
    """Compute sine s and cosine c of q + shift for a block of samples.

    The argument is reduced by multiples of pi; polynomials then give values accurate to rounding.
    """
    for k in range(NB):
        x = q[k] + shift
        n = (x * PER_PI + ROUNDING_SHIFT) - ROUNDING_SHIFT
        r = ((x - n * PI_PARTS[0]) - n * PI_PARTS[1]) - n * PI_PARTS[2]
        odd = n - 2.0 * ((n * 0.5 + ROUNDING_SHIFT) - ROUNDING_SHIFT)
        sign = 1.0 - 2.0 * odd * odd
        z = r * r
        p = SINE_COEFFICIENTS[0]
        for each in SINE_COEFFICIENTS[1:]:
            p = p * z + each
        g = COSINE_COEFFICIENTS[0]
        for each in COSINE_COEFFICIENTS[1:]:
            g = g * z + each
        s[k] = sign * (r + r * z * p)
        c[k] = sign * (1.0 - 0.5 * z + z * z * g)


@llvm_inline
def rotate_right_angle(J, v):
    """Components of v in a frame rotated about x by a right angle."""
    return v[0], v[2], -v[1]


@llvm_inline
def rotate_x(J, v):
    """Components of v in a frame rotated about x (cosine J[0], sine J[1])."""
    return v[0], J[0] * v[1] + J[1] * v[2], J[0] * v[2] - J[1] * v[1]


@llvm_inline
def compute_motion(J, turns, P, X, qd, qdd):
    """Compute the motion X of a body from the motion P of its carrier.

    The displacement of a prismatic joint is not included; see `add_displacement`.

    Args:
        J: Constants of the link.
        turns: 1 for a revolute joint, 0 for a prismatic joint or a fixed frame.
        P: Motion of the carrier.
        X: Motion of the body, overwritten.
        qd: Joint velocity.
        qdd: Joint acceleration.
    """
    lean, r = (J[0], J[1]), (J[2], J[3], J[4])
    for k in range(NB):
        c, s, o = X[C + k], X[S + k], acceleration_matrix(P, k)
        a = add_vectors(
            vector(P, A, k), (inner(o[0], r), inner(o[1], r), inner(o[2], r))
        )
        w = rotate_z(c, s, rotate_x(lean, vector(P, W, k)))
        e = rotate_z(c, s, rotate_x(lean, vector(P, E, k)))
        speed = turns * qd[k]
        w = w[0], w[1], w[2] + speed
        e = e[0] + w[1] * speed, e[1] - w[0] * speed, e[2] + turns * qdd[k]
        write_vector(X, W, k, w)
        write_vector(X, E, k, e)
        write_vector(X, A, k, rotate_z(c, s, rotate_x(lean, a)))
        xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
        xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
        write_vector(X, O, k, (-yy - zz, xy - e[2], xz + e[1]))
        write_vector(X, O + 3 * B, k, (xy + e[2], -xx - zz, yz - e[0]))
        write_vector(X, O + 6 * B, k, (xz - e[1], yz + e[0], -xx - yy))


@llvm_inline
def first_moment_entry(u, v, a, o, i):
    """Row entry of first-moment component i, `v O + a x u`, for a screw (u, v)."""
    return inner(v, matrix_column(o, i)) + cross(a, u)[i]


def screw_propagation(leaning):
    """Make `propagate_screw` for links with a twist angle of 90 degrees or of any size.

    Most joint axes are normal to the preceding axis; their rotation about x needs no products.

    Args:
        leaning: Function `rotate_right_angle` or `rotate_x`.
    """

    @llvm_inline
    def propagate_screw(J, P, V, X, Y):
        """Transform a screw from the carrier, P, to the body, V, and fill its row Y.

        The row entries belong to mbx, mby, Kxx, Kxy, Kxz, Kyz, Kzz.
        """
        lean, r = (J[0], J[1]), (J[2], J[3], J[4])
        for k in range(NB):
            c, s, z = X[C + k], X[S + k], X[Z + k]
            u = vector(P, 0, k)
            v = rotate_z(
                c, s, leaning(lean, add_vectors(vector(P, 3 * B, k), cross(u, r)))
            )
            u = rotate_z(c, s, leaning(lean, u))
            v = v[0] + u[1] * z, v[1] - u[0] * z, v[2]
            write_vector(V, 0, k, u)
            write_vector(V, 3 * B, k, v)
            e, a, o = vector(X, E, k), vector(X, A, k), acceleration_matrix(X, k)
            xy, xz, yz = o[0][1] + e[2], o[0][2] - e[1], o[1][2] + e[0]
            Y[k] = first_moment_entry(u, v, a, o, 0)
            Y[D + k] = first_moment_entry(u, v, a, o, 1)
            Y[2 * D + k] = u[0] * e[0] + u[1] * xz - u[2] * xy
            Y[3 * D + k] = u[1] * o[2][1] - u[0] * o[2][0] + u[2] * (o[0][0] - o[1][1])
            Y[4 * D + k] = u[0] * o[1][0] + u[1] * (o[2][2] - o[0][0]) - u[2] * o[1][2]
            Y[5 * D + k] = u[0] * (o[1][1] - o[2][2]) - u[1] * o[0][1] + u[2] * o[0][2]
            Y[6 * D + k] = u[0] * yz - u[1] * xz + u[2] * e[2]

    return propagate_screw


propagate_screw_square, propagate_screw_inclined = map(
    screw_propagation, (rotate_right_angle, rotate_x)
)


@llvm_inline
def add_displacement(X, q, qd, qdd):
    """Add a prismatic joint's displacement to the motion of its body."""
    for k in range(NB):
        z, speed = q[k], 2.0 * qd[k]
        x, y, zz = matrix_column(acceleration_matrix(X, k), 2)
        acceleration = (
            x * z + X[W + B + k] * speed,
            y * z - X[W + k] * speed,
            zz * z + qdd[k],
        )
        X[Z + k] = z
        write_vector(X, ZZ, k, acceleration)
        write_vector(X, A, k, add_vectors(vector(X, A, k), acceleration))


@llvm_inline
def propagate_force(J, P, V, X, Y):
    """Transform a screw without angular part from P to V, and fill its row Y.

    The row entries belong to mbx, mby.
    """
    lean = J[0], J[1]
    for k in range(NB):
        v, o = (
            rotate_z(X[C + k], X[S + k], rotate_x(lean, vector(P, 3 * B, k))),
            acceleration_matrix(X, k),
        )
        write_vector(V, 3 * B, k, v)
        Y[k], Y[D + k] = inner(v, matrix_column(o, 0)), inner(v, matrix_column(o, 1))


@llvm_inline
def fill_revolute_row(X, Y):
    """Fill the row of a revolute joint's screw on its own body.

    The screw is u = z, v = 0; the row entries are those of `propagate_screw`.
    """
    for k in range(NB):
        o, spin = acceleration_matrix(X, k), X[E + 2 * B + k]
        Y[k], Y[D + k] = X[A + B + k], -X[A + k]
        Y[2 * D + k], Y[3 * D + k] = -o[0][1] - spin, o[0][0] - o[1][1]
        Y[4 * D + k], Y[5 * D + k] = -o[1][2], o[0][2]
        Y[6 * D + k] = spin


@llvm_inline
def fill_prismatic_row(X, Y):
    """Fill the row (mbx, mby) of a prismatic joint's screw on its own body."""
    for k in range(NB):
        Y[k], Y[D + k] = X[O + 6 * B + k], X[O + 7 * B + k]


@llvm_inline
def fill_extra_entries(turns, V, X, Y):
    """Fill the row entries of mbz, Kyy and mbar, which only few bodies need.

    mbar has two entries: one for a body on the bedplate, one for its effect on the carriers.

    Args:
        turns: 1 for a screw with an angular part, 0 for a force.
        V: The screw.
        X: Motion of the body.
        Y: Rows, overwritten.
    """
    for k in range(NB):
        u, v = vector(V, 0, k), vector(V, 3 * B, k)
        u = turns * u[0], turns * u[1], turns * u[2]
        e, a, o, z = (
            vector(X, E, k),
            vector(X, A, k),
            acceleration_matrix(X, k),
            X[Z + k],
        )
        Y[k] = first_moment_entry(u, v, a, o, 2)
        Y[D + k] = u[1] * e[1] - u[0] * (o[1][2] + e[0]) + u[2] * (o[0][1] + e[2])
        Y[2 * D + k] = inner(v, a)
        # carriers include the mass of a sliding body already: only the displacement's part
        at_origin = v[0] - u[1] * z, v[1] + u[0] * z, v[2]
        Y[3 * D + k] = inner(at_origin, vector(X, ZZ, k)) + z * cross(a, u)[2]


@inline_sum
def dot(X, Y, n):
    """Inner product of two arrays of n numbers."""
    total = 0.0
    for k in range(n):
        total += X[k] * Y[k]
    return total


@numba_inline
def read_column(source, first, count, column, U):
    """Read samples of one column, padded with zeros to a full block."""
    values = source[first : first + count, column]
    for k in range(count):
        U[k] = values[k]
    for k in range(count, NB):
        U[k] = 0.0


@numba_inline
def differentiate(source, first, count, column, taps, N, U):
    """Convolve encoder samples with `taps`; write position, velocity, acceleration to U."""
    half = taps.shape[1] // 2
    for k in range(count + 2 * half):
        N[k] = source[first - half + k, column]
    for k in range(count + 2 * half, NB + 2 * half):
        N[k] = 0.0
    x, v, a = U[:NB], U[B : B + NB], U[2 * B : 2 * B + NB]
    for k in range(NB):
        x[k], v[k], a[k] = taps[0, half] * N[half + k], 0.0, taps[2, half] * N[half + k]
    for t in range(1, half + 1):
        before, after = N[half - t : half - t + NB], N[half + t : half + t + NB]
        h0, h1, h2 = taps[0, half + t], taps[1, half + t], taps[2, half + t]
        for k in range(NB):
            even = before[k] + after[k]
            x[k] += h0 * even
            v[k] += h1 * (after[k] - before[k])
            a[k] += h2 * even


@numba_inline
def read_link(i, robot, signals, first, count, work):
    """Read the coordinate of link i and its two derivatives for a block of samples."""
    j, U = robot.coordinate[i], work.U[i]
    if len(signals.velocity):
        read_column(signals.position, first, count, j, U[:B])
        read_column(signals.velocity, first, count, j, U[B : 2 * B])
        read_column(signals.acceleration, first, count, j, U[2 * B :])
    else:
        differentiate(signals.position, first, count, j, signals.taps, work.N, U)
    if len(work.squares):
        work.squares[0] += dot(U, U, 3 * B)


@numba_inline
def move_link(i, robot, work):
    """Compute the motion of link i for a block of samples."""
    X, P = work.X[robot.place[i]], work.X[robot.carrier[i]]
    U, J = work.U[i], robot.joint[i]
    q, qd, qdd = U[:B], U[B : 2 * B], U[2 * B :]
    X[Z : Z + B] = 0.0
    if robot.prismatic[i]:
        X[C : C + B], X[S : S + B] = J[6], J[7]
    else:
        sine_cosine(q, J[5], X[S : S + B], X[C : C + B])
    compute_motion(J, 0.0 if robot.prismatic[i] else 1.0, P, X, qd, qdd)
    if robot.prismatic[i] and robot.coordinate[i] >= 0:
        add_displacement(X, q, qd, qdd)


@numba_inline
def fill_link(i, robot, rows, work, Y, at):
    """Fill the entries of all rows for link i, starting at sample `at`."""
    X, J = work.X[robot.place[i]], robot.joint[i]
    for e in range(rows.first[i], rows.first[i + 1]):
        V, P = work.V[rows.target[e]], work.V[rows.source[e]]
        y = rows.slot[e] * D + at
        out = Y[y : y + 7 * D] if rows.direct[e] else work.T
        if rows.source[e] == rows.target[e]:
            if robot.prismatic[i]:
                fill_prismatic_row(X, out)
            else:
                fill_revolute_row(X, out)
        elif rows.force[e]:
            propagate_force(J, P, V, X, out)
        elif robot.square[i]:
            propagate_screw_square(J, P, V, X, out)
        else:
            propagate_screw_inclined(J, P, V, X, out)
        if rows.has_extra[e]:
            fill_extra_entries(0.0 if rows.force[e] else 1.0, V, X, work.T[7 * D :])
        for t in range(rows.copies[e], rows.copies[e + 1]):
            y, T = rows.copy_to[t] * D + at, work.T[rows.copy_from[t] * D :]
            for k in range(NB):
                Y[y + k] = T[k]


@numba_inline
def no_column(number, qd, qdd, Y):
    """Leave the regressor column of an unknown joint law unchanged."""


def column_with_law(number, column, others):
    """Extend the compiled function that fills regressor columns of joint laws by one law.

    Args:
        number: Index of the law in JOINT_LAWS.
        column: Column of the law as a function of velocity and acceleration.
        others: Compiled function of the previous laws, called for other indices.
    """
    column = llvm_inline(column)

    @numba_inline
    def law_column(law, qd, qdd, Y):
        if law == number:
            for k in range(NB):
                Y[k] = column(qd[k], qdd[k])
        else:
            others(law, qd, qdd, Y)

    return law_column


law_column = no_column
for number, law in enumerate(JOINT_LAWS):
    law_column = column_with_law(number, law.column, law_column)


@numba_inline
def fill_other_slots(rows, signals, first, count, work, Y, at):
    """Fill joint terms, measurements and rest flags of all rows, starting at sample `at`."""
    for t in range(len(rows.term_slot)):
        U, y = work.U[rows.term_link[t]], rows.term_slot[t] * D + at
        law_column(rows.term_law[t], U[B : 2 * B], U[2 * B :], Y[y : y + NB])
    for c in range(len(rows.measured)):
        y = rows.measured[c] * D + at
        measured = Y[y : y + NB]
        read_column(signals.measured, first, count, c, measured)
        if len(work.squares):
            work.squares[0] += dot(measured, measured, NB)
        if signals.deadband > 0.0:
            qd, y = work.U[rows.link[c]][B:], (rows.slots + c) * D + at
            for k in range(NB):
                Y[y + k] = 0.0 if abs(qd[k]) > signals.deadband else 1.0
        if len(signals.sample_mask):
            for s in range(rows.start[c], rows.start[c] + rows.width[c]):
                for k in range(count):
                    Y[s * D + at + k] *= signals.sample_mask[first + k, c]


@compiled_function
def fill_rows(robot, rows, signals, first, count, work, Y):
    """Fill unfiltered rows at `count` samples, padded with zeros to a full block.

    Args:
        robot: Arrays of the links.
        rows: Arrays of the rows.
        signals: The window.
        first: First sample.
        count: Number of samples.
        work: Workspace.
        Y: Rows, overwritten.
    """
    for at in range(0, count, NB):
        samples = min(NB, count - at)
        for i in range(
            len(robot.place)
        ):  # all links together: samples of joints share cache lines
            if robot.coordinate[i] >= 0:
                read_link(i, robot, signals, first + at, samples, work)
        for i in range(len(robot.place)):
            move_link(i, robot, work)
            fill_link(i, robot, rows, work, Y, at)
        fill_other_slots(rows, signals, first + at, samples, work, Y, at)
    if count % NB:
        for s in range(rows.slots):
            Y[s * D + count : s * D + count + NB - count % NB] = 0.0
