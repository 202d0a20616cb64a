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
def turn(c, s, x, y, z):
    """A vector in a frame turned about z."""
    return c * x + s * y, c * y - s * x, z


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
def square(ca, sa, y, z):
    """Leaning by a right angle."""
    return z, -y


@inline
def inclined(ca, sa, y, z):
    """Leaning by any angle."""
    return ca * y + sa * z, ca * z - sa * y


@inline
def move(ca, sa, r0, r1, r2, turns, P, X, qd, qdd):
    """The motion of a body from its carrier's, P, without what slides."""
    for k in range(NB):
        c, s = X[C + k], X[S + k]
        a0, a1, a2 = P[A + k], P[A + B + k], P[A + 2 * B + k]
        a0 += P[O + k] * r0 + P[O + B + k] * r1 + P[O + 2 * B + k] * r2
        a1 += P[O + 3 * B + k] * r0 + P[O + 4 * B + k] * r1 + P[O + 5 * B + k] * r2
        a2 += P[O + 6 * B + k] * r0 + P[O + 7 * B + k] * r1 + P[O + 8 * B + k] * r2
        w1, w2 = inclined(ca, sa, P[W + B + k], P[W + 2 * B + k])
        e1, e2 = inclined(ca, sa, P[E + B + k], P[E + 2 * B + k])
        a1, a2 = inclined(ca, sa, a1, a2)
        w0, w1, w2 = turn(c, s, P[W + k], w1, w2)
        e0, e1, e2 = turn(c, s, P[E + k], e1, e2)
        a0, a1, a2 = turn(c, s, a0, a1, a2)
        speed = turns * qd[k]
        w2 += speed
        e0 += w1 * speed
        e1 -= w0 * speed
        e2 += turns * qdd[k]
        X[W + k], X[W + B + k], X[W + 2 * B + k] = w0, w1, w2
        X[E + k], X[E + B + k], X[E + 2 * B + k] = e0, e1, e2
        X[A + k], X[A + B + k], X[A + 2 * B + k] = a0, a1, a2
        xx, yy, zz = w0 * w0, w1 * w1, w2 * w2
        X[O + k], X[O + 4 * B + k], X[O + 8 * B + k] = -yy - zz, -xx - zz, -xx - yy
        X[O + B + k], X[O + 3 * B + k] = w0 * w1 - e2, w0 * w1 + e2
        X[O + 2 * B + k], X[O + 6 * B + k] = w0 * w2 + e1, w0 * w2 - e1
        X[O + 5 * B + k], X[O + 7 * B + k] = w1 * w2 - e0, w1 * w2 + e0


def carrier(lean):
    """`carry` for joints that lean about x by a right angle, or by any.

    Most joints stand square on the one before: no product is spent on them.
    """

    @inline
    def carry(ca, sa, r0, r1, r2, P, V, X, Y):
        """A screw from the carrier, P, to the body, V, and the row it makes there, Y.

        Entries: mbx, mby, Kxx, Kxy, Kxz, Kyz, Kzz.
        """
        for k in range(NB):
            c, s, z = X[C + k], X[S + k], X[Z + k]
            u0, u1, u2 = P[k], P[B + k], P[2 * B + k]
            v0 = P[3 * B + k] + u1 * r2 - u2 * r1
            v1 = P[4 * B + k] + u2 * r0 - u0 * r2
            v2 = P[5 * B + k] + u0 * r1 - u1 * r0
            u1, u2 = lean(ca, sa, u1, u2)
            v1, v2 = lean(ca, sa, v1, v2)
            u0, u1, u2 = turn(c, s, u0, u1, u2)
            v0, v1, v2 = turn(c, s, v0, v1, v2)
            v0 += u1 * z
            v1 -= u0 * z
            V[k], V[B + k], V[2 * B + k] = u0, u1, u2
            V[3 * B + k], V[4 * B + k], V[5 * B + k] = v0, v1, v2
            e0, e1, e2 = X[E + k], X[E + B + k], X[E + 2 * B + k]
            o00, o01, o02 = X[O + k], X[O + B + k], X[O + 2 * B + k]
            o10, o11, o12 = X[O + 3 * B + k], X[O + 4 * B + k], X[O + 5 * B + k]
            o20, o21, o22 = X[O + 6 * B + k], X[O + 7 * B + k], X[O + 8 * B + k]
            wxy, wxz, wyz = o01 + e2, o02 - e1, o12 + e0
            a0, a1, a2 = X[A + k], X[A + B + k], X[A + 2 * B + k]
            Y[k] = a1 * u2 - a2 * u1 + v0 * o00 + v1 * o10 + v2 * o20
            Y[D + k] = a2 * u0 - a0 * u2 + v0 * o01 + v1 * o11 + v2 * o21
            Y[2 * D + k] = u0 * e0 + u1 * wxz - u2 * wxy
            Y[3 * D + k] = u1 * o21 - u0 * o20 + u2 * (o00 - o11)
            Y[4 * D + k] = u0 * o10 + u1 * (o22 - o00) - u2 * o12
            Y[5 * D + k] = u0 * (o11 - o22) - u1 * o01 + u2 * o02
            Y[6 * D + k] = u0 * wyz - u1 * wxz + u2 * e2

    return carry


carry_square, carry_inclined = map(carrier, (square, inclined))


@inline
def slide(X, q, qd, qdd):
    """What a prismatic joint's displacement adds to the motion of its body."""
    for k in range(NB):
        z, speed = q[k], 2.0 * qd[k]
        z0 = X[O + 2 * B + k] * z + X[W + B + k] * speed
        z1 = X[O + 5 * B + k] * z - X[W + k] * speed
        z2 = X[O + 8 * B + k] * z + qdd[k]
        X[Z + k], X[ZZ + k], X[ZZ + B + k], X[ZZ + 2 * B + k] = z, z0, z1, z2
        X[A + k] += z0
        X[A + B + k] += z1
        X[A + 2 * B + k] += z2


@inline
def push(ca, sa, P, V, X, Y):
    """`carry` of a screw that only slides: a force. Entries: mbx, mby."""
    for k in range(NB):
        v1, v2 = inclined(ca, sa, P[4 * B + k], P[5 * B + k])
        v0, v1, v2 = turn(X[C + k], X[S + k], P[3 * B + k], v1, v2)
        V[3 * B + k], V[4 * B + k], V[5 * B + k] = v0, v1, v2
        Y[k] = v0 * X[O + k] + v1 * X[O + 3 * B + k] + v2 * X[O + 6 * B + k]
        Y[D + k] = v0 * X[O + B + k] + v1 * X[O + 4 * B + k] + v2 * X[O + 7 * B + k]


@inline
def turn_here(X, Y):
    """The row of a revolute joint's screw, u = z, on its own body. Entries as of `carry`."""
    for k in range(NB):
        Y[k], Y[D + k] = X[A + B + k], -X[A + k]
        Y[2 * D + k] = -X[O + B + k] - X[E + 2 * B + k]
        Y[3 * D + k] = X[O + k] - X[O + 4 * B + k]
        Y[4 * D + k], Y[5 * D + k] = -X[O + 5 * B + k], X[O + 2 * B + k]
        Y[6 * D + k] = X[E + 2 * B + k]


@inline
def slide_here(X, Y):
    """The row of a prismatic joint's screw, v = z, on its own body. Entries as of `push`."""
    for k in range(NB):
        Y[k], Y[D + k] = X[O + 6 * B + k], X[O + 7 * B + k]


@inline
def rest(turns, V, X, Y):
    """The entries that few bodies have: mbz, Kyy, and mbar twice (outermost, inward)."""
    for k in range(NB):
        u0, u1, u2 = turns * V[k], turns * V[B + k], turns * V[2 * B + k]
        v0, v1, v2 = V[3 * B + k], V[4 * B + k], V[5 * B + k]
        a0, a1, a2 = X[A + k], X[A + B + k], X[A + 2 * B + k]
        e0, e1, e2 = X[E + k], X[E + B + k], X[E + 2 * B + k]
        z = X[Z + k]
        o02, o12, o22 = X[O + 2 * B + k], X[O + 5 * B + k], X[O + 8 * B + k]
        Y[k] = a0 * u1 - a1 * u0 + v0 * o02 + v1 * o12 + v2 * o22
        Y[D + k] = u1 * e1 - u0 * (o12 + e0) + u2 * (X[O + B + k] + e2)
        Y[2 * D + k] = v0 * a0 + v1 * a1 + v2 * a2
        # a sliding body's mass is known to its carriers already: they feel what the slide adds
        z0, z1, z2 = X[ZZ + k], X[ZZ + B + k], X[ZZ + 2 * B + k]
        Y[3 * D + k] = (v0 - u1 * z) * z0 + (v1 + u0 * z) * z1 + v2 * z2 + z * (u1 * a0 - u0 * a1)


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
    j = robot.coordinate[i]
    U = work.U[i * 3 * B : (i + 1) * 3 * B]
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
    X = work.X[robot.place[i] * BODY : (robot.place[i] + 1) * BODY]
    P = work.X[robot.carrier[i] * BODY : (robot.carrier[i] + 1) * BODY]
    U = work.U[i * 3 * B : (i + 1) * 3 * B]
    q, qd, qdd = U[:B], U[B : 2 * B], U[2 * B :]
    J = robot.joint[i]
    X[Z : Z + B] = 0.0
    if robot.slides[i]:
        turns = 0.0
        X[C : C + B], X[S : S + B] = J[6], J[7]
    else:
        turns = 1.0
        sine_cosine(q, J[5], X[S : S + B], X[C : C + B])
    move(J[0], J[1], J[2], J[3], J[4], turns, P, X, qd, qdd)
    if robot.slides[i] and robot.coordinate[i] >= 0:
        slide(X, q, qd, qdd)


@part
def fill_link(i, robot, rows, work, Y, at):
    """The entries of every row on link i, from column `at` of their slots on."""
    X = work.X[robot.place[i] * BODY : (robot.place[i] + 1) * BODY]
    J = robot.joint[i]
    for e in range(rows.first[i], rows.first[i + 1]):
        V = work.V[rows.target[e] * SCREW : (rows.target[e] + 1) * SCREW]
        P = work.V[rows.source[e] * SCREW : (rows.source[e] + 1) * SCREW]
        y = rows.slot[e] * D + at
        out = Y[y : y + 7 * D] if rows.direct[e] else work.T
        if rows.source[e] == rows.target[e]:
            if robot.slides[i]:
                slide_here(X, out)
            else:
                turn_here(X, out)
        elif rows.force[e]:
            push(J[0], J[1], P, V, X, out)
        elif robot.square[i]:
            carry_square(J[0], J[1], J[2], J[3], J[4], P, V, X, out)
        else:
            carry_inclined(J[0], J[1], J[2], J[3], J[4], P, V, X, out)
        if rows.rest[e]:
            rest(0.0 if rows.force[e] else 1.0, V, X, work.T[7 * D :])
        for t in range(rows.copies[e], rows.copies[e + 1]):
            y = rows.copy_to[t] * D + at
            T = work.T[rows.copy_from[t] * D :]
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
        U = work.U[rows.term_link[t] * 3 * B : (rows.term_link[t] + 1) * 3 * B]
        y = rows.term_slot[t] * D + at
        term(rows.term_law[t], U[B : 2 * B], U[2 * B :], Y[y : y + NB])
    for c in range(len(rows.measured)):
        y = rows.measured[c] * D + at
        load(signals.measured, first, count, c, Y[y : y + NB])
        if len(work.squares):
            work.squares[0] += dot(Y[y : y + NB], Y[y : y + NB], NB)
        if signals.deadband > 0.0:
            qd = work.U[rows.link[c] * 3 * B + B : rows.link[c] * 3 * B + 2 * B]
            y = (rows.slots + c) * D + at
            for k in range(NB):
                Y[y + k] = 0.0 if abs(qd[k]) > signals.deadband else 1.0


@plain
def fill(robot, rows, signals, first, count, work, Y):
    """Rows at `count` samples from `first` on, unfiltered; zeros up to a full block."""
    for at in range(0, count, NB):
        some = min(NB, count - at)
        for i in range(len(robot.place)):  # all at once: their samples share cache lines
            if robot.coordinate[i] >= 0:
                read_link(i, robot, signals, first + at, some, work)
        for i in range(len(robot.place)):
            move_link(i, robot, work)
            fill_link(i, robot, rows, work, Y, at)
        fill_own(rows, signals, first + at, some, work, Y, at)
    if count % NB:
        for s in range(rows.slots):
            Y[s * D + count : s * D + count + NB - count % NB] = 0.0
