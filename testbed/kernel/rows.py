"""Filling rows: coordinates are read or smoothed, bodies move, entries go to their slots."""

from __future__ import annotations

from testbed.kernel.compiler import inline, part, plain, summing
from testbed.kernel.constants import NB, B, D
from testbed.kernel.screws import (
    BODY,
    SCREW,
    C,
    S,
    Z,
    carry_inclined,
    carry_square,
    move,
    push,
    rest,
    sine_cosine,
    slide,
    slide_here,
    turn_here,
)
from testbed.robot.friction import LAWS


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
