"""The recursion: bodies move, screws are carried outward, rows are filled.

Every row is a screw: the row of a joint is the joint's axis, a row of the bedplate's wrench
one of the bedplate's six. Screws are carried outward from body to body, and on each body
meet the same few numbers of the body's motion. Samples run innermost: a "slot" is one
quantity over a block of samples, a run of contiguous numbers, so that loops are vectorised.

Frames    canonical (`canonical.py`): z along the joint
Witness   `dynamics.regressor`, which shares no code with this package
"""

from __future__ import annotations

from testbed.kernel.compiler import inline
from testbed.kernel.constants import COSINE, NB, PER_PI, PI, ROUND, SINE, B, D

# Slots of a body's motion.
C, S = 0, B  # cosine and sine of the joint's turn
Z, ZZ = 2 * B, 3 * B  # displacement along z, its absolute second derivative
W, E, A = 6 * B, 9 * B, 12 * B  # angular velocity, its rate, acceleration less gravity
O = 15 * B  # wd~ + w~ w~, row by row
BODY = 24 * B

SCREW = 6 * B  # of a screw: turning u, sliding v at the body's origin


@inline
def cross(a0, a1, a2, b0, b1, b2):
    """A x b."""
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


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
        p = p * z + SINE[1]
        p = p * z + SINE[2]
        p = p * z + SINE[3]
        p = p * z + SINE[4]
        p = p * z + SINE[5]
        p = p * z + SINE[6]
        p = p * z + SINE[7]
        g = COSINE[0]
        g = g * z + COSINE[1]
        g = g * z + COSINE[2]
        g = g * z + COSINE[3]
        g = g * z + COSINE[4]
        g = g * z + COSINE[5]
        g = g * z + COSINE[6]
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
