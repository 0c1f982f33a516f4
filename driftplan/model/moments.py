"""The error-moment algebra: how the errors of consecutive pieces of odometry add up, exactly to second order.

The plane is the complex plane. A pose is (u, p) with heading ``u = exp(jθ)`` and position p; poses multiply as
``(u_A, p_A)(u_B, p_B) = (u_A u_B, p_A + u_A p_B)``. A piece of odometry has the true motion (u, p) and the errors

* ``δ = conj(u) û - 1`` of the estimated heading û, and
* ``e = p̂ - p`` of the estimated position p̂, in the frame of the piece's start.

When the errors of two pieces are independent, the first and second moments of (δ, e) of the joined piece follow from
those of the parts: a monoid (associative, with identity), so that a path costs one composition per piece. The moments
are those of *errors*, never differences of large estimates, so nothing cancels when the noise is tiny.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from driftplan.arrays import Array, Columns

_SMALLEST_COHERENCE = 1e-100  # a smaller factor is taken for this: what it multiplies is forgotten either way
_FEW = 16  # up to so many pieces, Python's numbers beat numpy's arrays
_CHUNK_LOG = 400.0  # natural logarithm by which the coherence may fall within one cumulative product: no underflow


@dataclass(frozen=True, slots=True, eq=False)
class Moments(Columns):
    """True motion and error moments of pieces of odometry, over any leading axes."""

    u: Array  # true rotation, unit complex
    p: Array  # true translation, metres, in the frame of the piece's start
    d1: Array  # E[δ] of the heading error δ (no unit)
    d2: Array  # E[δ²]
    D: Array  # E[|δ|²]; for true rotations -2 Re d1
    e1: Array  # E[e] of the position error e, m
    N: Array  # E[|e|²], m²
    e2: Array  # E[e²], m²
    a: Array  # E[e conj(δ)], m
    b: Array  # E[e δ], m

    @property
    def shape(self) -> tuple[int, ...]:
        return np.shape(self.N)

    @classmethod
    def concatenate(cls, parts: Iterable[Moments], axis: int = -1) -> Moments:
        """Pieces one after the other along an axis."""
        return cls(*(np.concatenate(x, axis=axis) for x in zip(*(part.arrays() for part in parts), strict=True)))

    @classmethod
    def stack(cls, pieces: Iterable[Moments]) -> Moments:
        """Single pieces, in Python's numbers or not, as arrays (n,)."""
        u, p, d1, d2, D, e1, N, e2, a, b = (np.array(x) for x in zip(*map(_fields, pieces), strict=True))
        return cls(u, p, d1, d2, D.real, e1, N.real, e2, a, b)

    def arrays(self) -> tuple[Array, ...]:
        """The ten arrays, in the order of the attributes, broadcast against each other."""
        own, shape = _fields(self), self.shape
        return own if all(np.shape(x) == shape for x in own) else tuple(np.broadcast_arrays(*own))

    def rotated(self, u: Array | complex) -> Moments:
        """The same pieces after an error-free turn by the unit complex ``u``: cheaper than composing with one."""
        return replace(self, u=u * self.u, p=u * self.p, e1=u * self.e1, e2=u * u * self.e2, a=u * self.a, b=u * self.b)


def _fields(X: Moments) -> tuple[Array, ...]:
    return (X.u, X.p, X.d1, X.d2, X.D, X.e1, X.N, X.e2, X.a, X.b)


def identity(shape: tuple[int, ...] = ()) -> Moments:
    """The piece in which nothing happens: neutral for `compose`."""
    zero = np.zeros(shape)
    return Moments(np.ones(shape), *([zero] * 9))


def compose(A: Moments, B: Moments, lever_B: tuple[Array, ...] | None = None) -> Moments:
    """The piece that is A followed by B, their errors independent; ``lever_B`` is ``lever(B)``, if it is known.

    Source: the group product of the estimates, ``1 + δ = (1 + δ_A)(1 + δ_B)`` and
    ``e = e_A + u_A (e_B + δ_A (p_B + e_B))``, multiplied out and averaged; a polynomial identity, so associative.

    >>> compose(identity(), identity()).N.item()
    0.0
    """
    u, pB, d1A, d2A, DA, d1B, e1B, d1B_ = A.u, B.p, A.d1, A.d2, A.D, B.d1, B.e1, B.d1.conjugate()
    q1, Q, q2, epsilon, eta, kappa, lam = lever(B) if lever_B is None else lever_B
    e1 = A.e1 + u * (e1B + d1A * q1)
    cross = u.conjugate() * (A.e1 * e1B.conjugate() + A.a * q1.conjugate())
    N = A.N + B.N + 2 * (d1A.conjugate() * epsilon + cross).real + DA * Q
    e2 = A.e2 + u * (u * (B.e2 + 2 * d1A * eta + d2A * q2) + 2 * (A.e1 * e1B + A.b * q1))
    a = A.a + (A.e1 + A.a) * d1B_ + u * (B.a + d1A.conjugate() * (e1B + B.a) + DA * (q1 + kappa) + d1A * kappa)
    b = A.b + (A.e1 + A.b) * d1B + u * (B.b + d1A * (e1B + B.b) + d2A * (q1 + lam) + d1A * lam)
    d1 = d1A + d1B + d1A * d1B
    d2 = d2A * (1 + 2 * d1B + B.d2) + 2 * d1A * (d1B + B.d2) + B.d2
    D = DA * (1 + 2 * d1B.real + B.D) + 2 * (d1A * (d1B_ + B.D)).real + B.D
    return Moments(u * B.u, A.p + u * pB, d1, d2, D, e1, N, e2, a, b)


def power(X: Moments, count: Array | int | float) -> Moments:
    """``count`` copies of X in a row, in O(log count) compositions: whole numbers >= 0, broadcast against X."""
    count = np.asarray(count)
    X = _broadcast(X, count.shape)
    if 0 < np.size(X.N) <= _FEW:
        counts = np.broadcast_to(count, X.shape).ravel().tolist()
        powers = Moments.stack(_scalar_power(x, int(n)) for x, n in zip(X.numbers(), counts, strict=True))
        return Moments(*(x.reshape(X.shape) for x in powers.arrays()))
    odd, left = count % 2 == 1, count // 2
    result = X if odd.all() else _where(odd, X, identity(X.shape))
    while left.any():
        X, odd, left = compose(X, X), left % 2 == 1, left // 2
        if odd.any():
            result = _where(odd, compose(result, X), result)
    return result


def _scalar_power(X: Moments, count: int) -> Moments:
    """`power` of one piece made of Python numbers, on which composing costs a thirtieth of what numpy's calls do."""
    result = X if count % 2 else None
    while count := count // 2:
        X = compose(X, X)
        if count % 2:
            result = X if result is None else compose(result, X)
    return Moments(1.0, *([0.0] * 9)) if result is None else result  # type: ignore[arg-type]


def doubled(X: Moments, times: Array) -> Moments:
    """X composed with itself ``times`` times over, i.e. 2**times copies; only the pieces that need it are touched."""
    if not times.any():
        return X
    flat = [np.array(x).reshape(-1) for x in X.arrays()]
    left = np.array(np.broadcast_to(times, X.shape)).reshape(-1)
    while (todo := np.flatnonzero(left > 0)).size:
        part = Moments(*(x[todo] for x in flat))
        for x, new in zip(flat, compose(part, part).arrays(), strict=True):
            x[todo] = new
        left[todo] -= 1
    return Moments(*(x.reshape(X.shape) for x in flat))


def scan(pieces: Moments, start: Moments) -> Moments:
    """All prefixes (..., m + 1): ``start``, ``start·piece_0``, ``start·piece_0·piece_1``, … along the last axis.

    Appending pieces one by one makes every moment obey a linear recurrence ``x ← c x + f`` whose f involves only
    moments found before it, so each is a cumulative product and a cumulative sum over the whole path. Where the
    coherence c would underflow the path is cut in chunks.
    """
    done = [Moments(*(x[..., None] for x in _broadcast(start, pieces.shape[:-1]).arrays()))]
    for lo, hi in _chunks(pieces):
        done.append(_scan_chunk(pieces[..., lo:hi], done[-1][..., -1])[..., 1:])
    return done[0] if len(done) == 1 else Moments.concatenate(done)


def _scan_chunk(B: Moments, start: Moments) -> Moments:
    """`scan` where no cumulative product underflows. Letters as in `compose`; capitals A are the prefixes."""
    u = _cumulative(np.multiply, B.u, start.u)
    u /= np.abs(u)
    p = _cumulative(np.add, u[..., :-1] * B.p, start.p)
    uA, d1B, d1B_ = u[..., :-1], B.d1, np.conj(B.d1)
    q1, Q, q2, epsilon, eta, kappa, lam = lever(B)

    coherence = _Coherence(1 + d1B)
    d1 = coherence.recur(d1B, start.d1)
    d1A = d1[..., :-1]
    d2 = _Coherence(1 + 2 * d1B + B.d2).recur(2 * d1A * (d1B + B.d2) + B.d2, start.d2)
    D = _Coherence(1 + 2 * d1B.real + B.D).recur(2 * (d1A * (d1B_ + B.D)).real + B.D, start.D)
    d2A, DA = d2[..., :-1], D[..., :-1]

    e1 = _cumulative(np.add, uA * (B.e1 + d1A * q1), start.e1)
    e1A = e1[..., :-1]
    gain_a = e1A * d1B_ + uA * (B.a + np.conj(d1A) * (B.e1 + B.a) + DA * (q1 + kappa) + d1A * kappa)
    gain_b = e1A * d1B + uA * (B.b + d1A * (B.e1 + B.b) + d2A * (q1 + lam) + d1A * lam)
    a = np.conj(coherence.recur(np.conj(gain_a), np.conj(start.a)))
    b = coherence.recur(gain_b, start.b)
    cross = np.conj(uA) * (e1A * np.conj(B.e1) + a[..., :-1] * np.conj(q1))
    gain_N = B.N + 2 * (np.conj(d1A) * epsilon + cross).real + DA * Q
    gain_e2 = uA * (uA * (B.e2 + 2 * d1A * eta + d2A * q2) + 2 * (e1A * B.e1 + b[..., :-1] * q1))
    N = _cumulative(np.add, gain_N, start.N)
    e2 = _cumulative(np.add, gain_e2, start.e2)
    return Moments(u, p, d1, d2, D, e1, N, e2, a, b)


class _Coherence:
    """Solves ``x ← c x + f`` along the last axis for one c and any f."""

    def __init__(self, c: Array):
        tiny = np.abs(c) < _SMALLEST_COHERENCE
        self.product = np.cumprod(np.where(tiny, _SMALLEST_COHERENCE, c) if tiny.any() else c, axis=-1)

    def recur(self, f: Array, x0: Array) -> Array:
        x = _cumulative(np.add, f / self.product, x0)
        x[..., 1:] *= self.product
        return x


def lever(B: Moments) -> tuple[Array, ...]:
    """Moments of q = p_B + e_B, the lever on which a heading error before B acts: E q, E|q|², E q², E[e_B conj q],
    E[e_B q], E[q conj δ_B], E[q δ_B]."""
    p, e1 = B.p, B.e1
    p_ = p.conjugate()
    q1 = p + e1
    epsilon = p_ * e1 + B.N
    eta = p * e1 + B.e2
    Q = (p_ * q1).real + epsilon.real
    return q1, Q, p * q1 + eta, epsilon, eta, p * B.d1.conjugate() + B.a, p * B.d1 + B.b


def _chunks(pieces: Moments) -> list[tuple[int, int]]:
    """Index ranges within each of which the worst coherence of the batch falls by at most exp(-_CHUNK_LOG) or so."""
    m = pieces.shape[-1]
    if m == 0:
        return []
    weakest = np.minimum(np.abs(1 + pieces.d1), np.abs(1 + 2 * pieces.d1 + pieces.d2))
    loss = -np.log(np.clip(weakest, _SMALLEST_COHERENCE, 1.0))
    chunk = np.cumsum(loss.reshape(-1, m).max(axis=0)) // _CHUNK_LOG
    return list(pairwise([0, *(np.flatnonzero(np.diff(chunk)) + 1).tolist(), m]))


def _cumulative(operation: np.ufunc, x: Array, first: Array) -> Array:
    """``first, first∘x0, first∘x0∘x1, …`` along the last axis."""
    out = np.empty((*x.shape[:-1], x.shape[-1] + 1), np.result_type(x, first))
    out[..., 0] = first
    out[..., 1:] = x
    return np.asarray(operation.accumulate(out, axis=-1, out=out))


def _where(condition: Array, yes: Moments, no: Moments) -> Moments:
    return Moments(*(np.where(condition, y, n) for y, n in zip(yes.arrays(), no.arrays(), strict=True)))


def _broadcast(X: Moments, shape: tuple[int, ...]) -> Moments:
    shape = np.broadcast_shapes(X.shape, shape)
    return X if shape == X.shape else Moments(*(np.broadcast_to(x, shape) for x in X.arrays()))
