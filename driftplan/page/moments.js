// The error-moment algebra of driftplan/model/moments.py: how errors of consecutive pieces of odometry add up.
//
// A piece is an array of 18 numbers: u, p, d1, d2 (complex), D, e1 (complex), N, e2, a, b (complex). A pose (u, p) is
// true; the other letters are moments of the heading error δ and the position error e in the frame of its start.

export const U = 0, P = 2, D1 = 4, D2 = 6, D = 8, E1 = 9, N = 11, E2 = 12, A = 14, B = 16;

/** The piece in which nothing happens, at a pose. */
export function nothing(ur = 1, ui = 0, pr = 0, pi = 0) { return [ur, ui, pr, pi, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]; }

/** The piece that is X followed by Y, their errors independent. */
export function compose(X, Y) {
  const [ur, ui, pr, pi, d1r, d1i, d2r, d2i, DX, e1r, e1i, NX, e2r, e2i, ar, ai, br, bi] = X;
  const [vr, vi, qr, qi, f1r, f1i, f2r, f2i, DY, g1r, g1i, NY, g2r, g2i, cr, ci, hr, hi] = Y;
  // moments of the lever q = p + e of Y: E q, E|q|², E q², E[e conj q], E[e q], E[q conj δ], E[q δ]
  const q1r = qr + g1r, q1i = qi + g1i;
  const epsr = qr * g1r + qi * g1i + NY, epsi = qr * g1i - qi * g1r;
  const etar = qr * g1r - qi * g1i + g2r, etai = qr * g1i + qi * g1r + g2i;
  const Q = qr * q1r + qi * q1i + epsr;
  const q2r = qr * q1r - qi * q1i + etar, q2i = qr * q1i + qi * q1r + etai;
  const kapr = qr * f1r + qi * f1i + cr, kapi = qi * f1r - qr * f1i + ci;
  const lamr = qr * f1r - qi * f1i + hr, lami = qr * f1i + qi * f1r + hi;
  const t1r = g1r + d1r * q1r - d1i * q1i, t1i = g1i + d1r * q1i + d1i * q1r;  // of e1; x of N, y of e2, z of a and b
  const x1r = e1r * g1r + e1i * g1i + ar * q1r + ai * q1i, x1i = e1i * g1r - e1r * g1i + ai * q1r - ar * q1i;
  const crossr = ur * x1r + ui * x1i;
  const newN = NX + NY + 2 * (d1r * epsr + d1i * epsi + crossr) + DX * Q;
  const y1r = g2r + 2 * (d1r * etar - d1i * etai) + d2r * q2r - d2i * q2i;
  const y1i = g2i + 2 * (d1r * etai + d1i * etar) + d2r * q2i + d2i * q2r;
  const y2r = ur * y1r - ui * y1i + 2 * (e1r * g1r - e1i * g1i + br * q1r - bi * q1i);
  const y2i = ur * y1i + ui * y1r + 2 * (e1r * g1i + e1i * g1r + br * q1i + bi * q1r);
  const s1r = g1r + cr, s1i = g1i + ci, r1r = q1r + kapr, r1i = q1i + kapi;
  const za1r = cr + d1r * s1r + d1i * s1i + DX * r1r + d1r * kapr - d1i * kapi;
  const za1i = ci + d1r * s1i - d1i * s1r + DX * r1i + d1r * kapi + d1i * kapr;
  const ear = e1r + ar, eai = e1i + ai;
  const s2r = g1r + hr, s2i = g1i + hi, r2r = q1r + lamr, r2i = q1i + lami;
  const zb1r = hr + d1r * s2r - d1i * s2i + d2r * r2r - d2i * r2i + d1r * lamr - d1i * lami;
  const zb1i = hi + d1r * s2i + d1i * s2r + d2r * r2i + d2i * r2r + d1r * lami + d1i * lamr;
  const ebr = e1r + br, ebi = e1i + bi;
  const m2r = 1 + 2 * f1r + f2r, m2i = 2 * f1i + f2i, w2r = f1r + f2r, w2i = f1i + f2i;  // of d2
  return [
    ur * vr - ui * vi, ur * vi + ui * vr,
    pr + ur * qr - ui * qi, pi + ur * qi + ui * qr,
    d1r + f1r + d1r * f1r - d1i * f1i, d1i + f1i + d1r * f1i + d1i * f1r,
    d2r * m2r - d2i * m2i + 2 * (d1r * w2r - d1i * w2i) + f2r,
    d2r * m2i + d2i * m2r + 2 * (d1r * w2i + d1i * w2r) + f2i,
    DX * (1 + 2 * f1r + DY) + 2 * (d1r * (f1r + DY) + d1i * f1i) + DY,
    e1r + ur * t1r - ui * t1i, e1i + ur * t1i + ui * t1r,
    newN,
    e2r + ur * y2r - ui * y2i, e2i + ur * y2i + ui * y2r,
    ar + ear * f1r + eai * f1i + ur * za1r - ui * za1i, ai + eai * f1r - ear * f1i + ur * za1i + ui * za1r,
    br + ebr * f1r - ebi * f1i + ur * zb1r - ui * zb1i, bi + ebr * f1i + ebi * f1r + ur * zb1i + ui * zb1r,
  ];
}

/** X composed with itself `times` times over: 2**times copies. */
export function doubled(X, times) {
  for (let k = 0; k < times; k++) X = compose(X, X);
  return X;
}
