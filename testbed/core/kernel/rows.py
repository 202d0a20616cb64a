"""Filling rows: coordinates are read or smoothed, bodies move, entries go to their slots."""

from __future__ import annotations

from testbed.core.kernel.compiler import inline, part, plain, summing
from testbed.core.kernel.records import COSINE, NB, PER_PI, PI, ROUND, SINE, B, D
from testbed.core.robot.friction import LAWS

# Slots of a body's motion.
C, S = 0, B  # cosine and sine of the joint's turn
Z, ZZ = 2 * B, 3 * B  # displacement along z, its absolute second derivative
W, E, A = 6 * B, 9 * B, 12 * B  # angular velocity, its rate, acceleration less gravity
O = 15 * B  # wd~ + w~ w~, row by row
BODY = 24 * B

SCREW = 6 * B  # of a screw: turning u, sliding v at the body's origin


@inline
def vector(X, at, k):
    """Three slots of a sample, from slot `at` on."""
    return X[at + k], X[at + B + k], X[at + 2 * B + k]


@inline
def put(X, at, k, v):
    """Write a sample of three slots, from slot `at` on."""
    X[at + k], X[at + B + k], X[at + 2 * B + k] = v


@inline
def matrix(X, k):
    """O of a body, row by row."""
    return vector(X, O, k), vector(X, O + 3 * B, k), vector(X, O + 6 * B, k)


@inline
def plus(a, b):
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def cross(a, b):
    """Cross product of two vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@inline
def inner(a, b):
    """Inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def column(o, i):
    """A column of a matrix of rows."""
    return o[0][i], o[1][i], o[2][i]


@inline
def turn(c, s, v):
    """A vector in a frame turned about z."""
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


@inline
def sine_cosine(q, shift, s, c):
    """Of q + shift: polynomials after taking off multiples of pi, to rounding."""
    for k in range(NB):
        x = q[k] + shift
        n = (x * PER_PI + ROUND) - ROUND
        r = ((x - n * PI[0]) - n * PI[1]) - n * PI[2]
        odd = n - 2.0 * ((n * 0.5 + ROUND) - ROUND)
        sign = 1.0 - 2.0 * odd * odd
        z = r * r
        p = SINE[0]
        for each in SINE[1:]:
            p = p * z + each
        g = COSINE[0]
        for each in COSINE[1:]:
            g = g * z + each
        s[k] = sign * (r + r * z * p)
        c[k] = sign * (1.0 - 0.5 * z + z * z * g)


@inline
def square(J, v):
    """A vector in a frame that leans about x by a right angle."""
    return v[0], v[2], -v[1]


@inline
def inclined(J, v):
    """A vector in a frame that leans about x by any angle."""
    return v[0], J[0] * v[1] + J[1] * v[2], J[0] * v[2] - J[1] * v[1]


@inline
def move(J, turns, P, X, qd, qdd):
    """The motion of a body from its carrier's, P, without what slides."""
    lean, r = (J[0], J[1]), (J[2], J[3], J[4])
    for k in range(NB):
        c, s, o = X[C + k], X[S + k], matrix(P, k)
        a = plus(vector(P, A, k), (inner(o[0], r), inner(o[1], r), inner(o[2], r)))
        w = turn(c, s, inclined(lean, vector(P, W, k)))
        e = turn(c, s, inclined(lean, vector(P, E, k)))
        speed = turns * qd[k]
        w = w[0], w[1], w[2] + speed
        e = e[0] + w[1] * speed, e[1] - w[0] * speed, e[2] + turns * qdd[k]
        put(X, W, k, w)
        put(X, E, k, e)
        put(X, A, k, turn(c, s, inclined(lean, a)))
        xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
        xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
        put(X, O, k, (-yy - zz, xy - e[2], xz + e[1]))
        put(X, O + 3 * B, k, (xy + e[2], -xx - zz, yz - e[0]))
        put(X, O + 6 * B, k, (xz - e[1], yz + e[0], -xx - yy))


@inline
def first_moment(u, v, a, o, i):
    """Entry of a first moment: component i of v O + a x u."""
    return inner(v, column(o, i)) + cross(a, u)[i]


def carrier(leaning):
    """`carry` for joints that lean about x by a right angle, or by any.

    Most joints stand square on the one before: no product is spent on them.
    """

    @inline
    def carry(J, P, V, X, Y):
        """A screw from the carrier, P, to the body, V, and the row it makes there, Y.

        Entries: mbx, mby, Kxx, Kxy, Kxz, Kyz, Kzz.
        """
        lean, r = (J[0], J[1]), (J[2], J[3], J[4])
        for k in range(NB):
            c, s, z = X[C + k], X[S + k], X[Z + k]
            u = vector(P, 0, k)
            v = turn(c, s, leaning(lean, plus(vector(P, 3 * B, k), cross(u, r))))
            u = turn(c, s, leaning(lean, u))
            v = v[0] + u[1] * z, v[1] - u[0] * z, v[2]
            put(V, 0, k, u)
            put(V, 3 * B, k, v)
            e, a, o = vector(X, E, k), vector(X, A, k), matrix(X, k)
            xy, xz, yz = o[0][1] + e[2], o[0][2] - e[1], o[1][2] + e[0]
            Y[k] = first_moment(u, v, a, o, 0)
            Y[D + k] = first_moment(u, v, a, o, 1)
            Y[2 * D + k] = u[0] * e[0] + u[1] * xz - u[2] * xy
            Y[3 * D + k] = u[1] * o[2][1] - u[0] * o[2][0] + u[2] * (o[0][0] - o[1][1])
            Y[4 * D + k] = u[0] * o[1][0] + u[1] * (o[2][2] - o[0][0]) - u[2] * o[1][2]
            Y[5 * D + k] = u[0] * (o[1][1] - o[2][2]) - u[1] * o[0][1] + u[2] * o[0][2]
            Y[6 * D + k] = u[0] * yz - u[1] * xz + u[2] * e[2]

    return carry


carry_square, carry_inclined = map(carrier, (square, inclined))


@inline
def slide(X, q, qd, qdd):
    """What a prismatic joint's displacement adds to the motion of its body."""
    for k in range(NB):
        z, speed = q[k], 2.0 * qd[k]
        x, y, along = column(matrix(X, k), 2)
        more = (
            x * z + X[W + B + k] * speed,
            y * z - X[W + k] * speed,
            along * z + qdd[k],
        )
        X[Z + k] = z
        put(X, ZZ, k, more)
        put(X, A, k, plus(vector(X, A, k), more))


@inline
def push(J, P, V, X, Y):
    """`carry` of a screw that only slides: a force. Entries: mbx, mby."""
    lean = J[0], J[1]
    for k in range(NB):
        v, o = (
            turn(X[C + k], X[S + k], inclined(lean, vector(P, 3 * B, k))),
            matrix(X, k),
        )
        put(V, 3 * B, k, v)
        Y[k], Y[D + k] = inner(v, column(o, 0)), inner(v, column(o, 1))


@inline
def turn_here(X, Y):
    """The row of a revolute joint's screw, u = z, on its own body. Entries as of `carry`."""
    for k in range(NB):
        o, spin = matrix(X, k), X[E + 2 * B + k]
        Y[k], Y[D + k] = X[A + B + k], -X[A + k]
        Y[2 * D + k], Y[3 * D + k] = -o[0][1] - spin, o[0][0] - o[1][1]
        Y[4 * D + k], Y[5 * D + k] = -o[1][2], o[0][2]
        Y[6 * D + k] = spin


@inline
def slide_here(X, Y):
    """The row of a prismatic joint's screw, v = z, on its own body. Entries as of `push`."""
    for k in range(NB):
        Y[k], Y[D + k] = X[O + 6 * B + k], X[O + 7 * B + k]


@inline
def rest(turns, V, X, Y):
    """The entries that few bodies have: mbz, Kyy, and mbar twice (outermost, inward)."""
    for k in range(NB):
        u, v = vector(V, 0, k), vector(V, 3 * B, k)
        u = turns * u[0], turns * u[1], turns * u[2]
        e, a, o, z = vector(X, E, k), vector(X, A, k), matrix(X, k), X[Z + k]
        Y[k] = first_moment(u, v, a, o, 2)
        Y[D + k] = u[1] * e[1] - u[0] * (o[1][2] + e[0]) + u[2] * (o[0][1] + e[2])
        Y[2 * D + k] = inner(v, a)
        # a sliding body's mass is known to its carriers already: they feel what the slide adds
        at_origin = v[0] - u[1] * z, v[1] + u[0] * z, v[2]
        Y[3 * D + k] = inner(at_origin, vector(X, ZZ, k)) + z * cross(a, u)[2]


@summing
def dot(X, Y, n):
    """X . Y."""
    total = 0.0
    for k in range(n):
        total += X[k] * Y[k]
    return total


@part
def load(source, first, count, column, U):
    """Samples of one column; those past the end are zero."""
    values = source[first : first + count, column]
    for k in range(count):
        U[k] = values[k]
    for k in range(count, NB):
        U[k] = 0.0


@part
def smooth(source, first, count, column, taps, N, U):
    """Position and its two derivatives by symmetric convolution of the encoder's samples."""
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


@part
def read_link(i, robot, signals, first, count, work):
    """The coordinate of link i and its two derivatives."""
    j, U = robot.coordinate[i], work.U[i]
    if len(signals.velocity):
        load(signals.position, first, count, j, U[:B])
        load(signals.velocity, first, count, j, U[B : 2 * B])
        load(signals.acceleration, first, count, j, U[2 * B :])
    else:
        smooth(signals.position, first, count, j, signals.taps, work.N, U)
    if len(work.squares):
        work.squares[0] += dot(U, U, 3 * B)


@part
def move_link(i, robot, work):
    """The motion of link i."""
    X, P = work.X[robot.place[i]], work.X[robot.carrier[i]]
    U, J = work.U[i], robot.joint[i]
    q, qd, qdd = U[:B], U[B : 2 * B], U[2 * B :]
    X[Z : Z + B] = 0.0
    if robot.slides[i]:
        X[C : C + B], X[S : S + B] = J[6], J[7]
    else:
        sine_cosine(q, J[5], X[S : S + B], X[C : C + B])
    move(J, 0.0 if robot.slides[i] else 1.0, P, X, qd, qdd)
    if robot.slides[i] and robot.coordinate[i] >= 0:
        slide(X, q, qd, qdd)


@part
def fill_link(i, robot, rows, work, Y, at):
    """The entries of every row on link i, from column `at` of their slots on."""
    X, J = work.X[robot.place[i]], robot.joint[i]
    for e in range(rows.first[i], rows.first[i + 1]):
        V, P = work.V[rows.target[e]], work.V[rows.source[e]]
        y = rows.slot[e] * D + at
        out = Y[y : y + 7 * D] if rows.direct[e] else work.T
        if rows.source[e] == rows.target[e]:
            if robot.slides[i]:
                slide_here(X, out)
            else:
                turn_here(X, out)
        elif rows.force[e]:
            push(J, P, V, X, out)
        elif robot.square[i]:
            carry_square(J, P, V, X, out)
        else:
            carry_inclined(J, P, V, X, out)
        if rows.rest[e]:
            rest(0.0 if rows.force[e] else 1.0, V, X, work.T[7 * D :])
        for t in range(rows.copies[e], rows.copies[e + 1]):
            y, T = rows.copy_to[t] * D + at, work.T[rows.copy_from[t] * D :]
            for k in range(NB):
                Y[y + k] = T[k]


@part
def no_term(number, qd, qdd, Y):
    """The column of no law."""


def terms_with(number, column, others):
    """The column of a joint's own law by the law's number: of one law more than `others`."""
    column = inline(column)

    @part
    def term(law, qd, qdd, Y):
        if law == number:
            for k in range(NB):
                Y[k] = column(qd[k], qdd[k])
        else:
            others(law, qd, qdd, Y)

    return term


term = no_term
for number, law in enumerate(LAWS):
    term = terms_with(number, law.column, term)


@part
def fill_own(rows, signals, first, count, work, Y, at):
    """What rows hold besides bodies: own terms, the measurement, whether the joint rests."""
    for t in range(len(rows.term_slot)):
        U, y = work.U[rows.term_link[t]], rows.term_slot[t] * D + at
        term(rows.term_law[t], U[B : 2 * B], U[2 * B :], Y[y : y + NB])
    for c in range(len(rows.measured)):
        y = rows.measured[c] * D + at
        measured = Y[y : y + NB]
        load(signals.measured, first, count, c, measured)
        if len(work.squares):
            work.squares[0] += dot(measured, measured, NB)
        if signals.deadband > 0.0:
            qd, y = work.U[rows.link[c]][B:], (rows.slots + c) * D + at
            for k in range(NB):
                Y[y + k] = 0.0 if abs(qd[k]) > signals.deadband else 1.0
        if len(signals.counts):
            for s in range(rows.start[c], rows.start[c] + rows.width[c]):
                for k in range(count):
                    Y[s * D + at + k] *= signals.counts[first + k, c]


@plain
def fill(robot, rows, signals, first, count, work, Y):
    """Rows at `count` samples from `first` on, unfiltered; zeros up to a full block."""
    for at in range(0, count, NB):
        some = min(NB, count - at)
        for i in range(
            len(robot.place)
        ):  # all at once: their samples share cache lines
            if robot.coordinate[i] >= 0:
                read_link(i, robot, signals, first + at, some, work)
        for i in range(len(robot.place)):
            move_link(i, robot, work)
            fill_link(i, robot, rows, work, Y, at)
        fill_own(rows, signals, first + at, some, work, Y, at)
    if count % NB:
        for s in range(rows.slots):
            Y[s * D + count : s * D + count + NB - count % NB] = 0.0
