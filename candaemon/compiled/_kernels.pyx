# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The hot loops of filters, tracks, tables and logs, compiled; each does what its caller does in numpy, to the last bit.

Every number comes from the same operations in the same order as there: sums run from the first term to the last, and the
build forbids fused multiply-adds. Logarithms, sines and the like, which libraries round in ways of their own, stay in
numpy, or are those of Python: its `math`, and `pow` as in its powers. No shape is checked here: the callers give arrays
of the right ones.

What has one operation or a few for each of many arrays takes them as buffers, `object[double, ndim=1, mode="strided"]`: a
memoryview, `double[:]`, takes 0.1 µs longer to begin with, but it can be passed on, and loops over several dimensions
run faster. Without a mode each element would be asked whether it is a pointer.
"""

from cpython.bytes cimport PyBytes_AS_STRING, PyBytes_FromStringAndSize
from libc.math cimport INFINITY, M_PI, NAN, copysign, fabs, fmod, isfinite, llrint, pow, rint, sqrt
from libc.stdlib cimport free, malloc
from libc.string cimport memchr, memcmp, memcpy

from math import asin, cos, hypot, remainder, sin

import numpy as np

REVISION = 148

cdef double LEAST_VARIANCE = 1e-100
cdef double LOST = 1e-13
cdef double FARTHEST = 1e15
cdef double RAYLEIGH = (4.0 - M_PI) / M_PI


cdef inline double larger(double a, double b) noexcept nogil:
    """np.maximum: not a number if one is not."""
    cdef double most = a if a > b else b  # apart from the next line, so that several are compared at once
    return a if a != a else most


cdef inline double bounded(double a) noexcept nogil:
    cdef double within
    a = larger(a, -FARTHEST)
    within = a if a < FARTHEST else FARTHEST
    return a if a != a else within


def halved(double[:, :, ::1] covariance):
    """Make matrices (n, D, D) symmetric in place."""
    cdef Py_ssize_t n = covariance.shape[0], d = covariance.shape[1], t, a, b
    cdef double value
    with nogil:
        for t in range(n):
            for a in range(d):
                for b in range(a, d):
                    value = (covariance[t, a, b] + covariance[t, b, a]) * 0.5
                    covariance[t, a, b] = value
                    covariance[t, b, a] = value


cdef double keep_within(double* half, const double* variance, Py_ssize_t d) noexcept nogil:
    """Let no innovation explain more of a component than there is, in place; return by what its root is larger then."""
    cdef double excess = 1.0
    cdef bint beyond = False
    cdef Py_ssize_t a
    for a in range(d):
        if half[a] * half[a] > variance[a]:
            beyond = True
    if not beyond:
        return 1.0
    for a in range(d):
        if half[a] * half[a] > variance[a]:
            if variance[a] <= 0.0:
                half[a] = 0.0
            else:
                excess = larger(excess, half[a] * half[a] / variance[a])
    for a in range(d):
        half[a] = half[a] / sqrt(excess)
    return sqrt(excess)


def update_position(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const double[:, :, :] position,
    const double[:, :, :, :] noise,
):
    """Update states (k, M, D) in place with positions (k, 1, 2); return NIS and root of the determinant of S, (k, M)."""
    cdef Py_ssize_t n = mean.shape[0], m = mean.shape[1], d = mean.shape[2], t, j, a, b
    cdef double xx, yy, first, slope, second, x, y
    cdef double h[2][16]
    cdef double variance[16]
    nis_array, root_array = np.empty((n, m)), np.empty((n, m))
    cdef double[:, ::1] nis = nis_array, root = root_array
    with nogil:
        for t in range(n):
            for j in range(m):
                xx = covariance[t, j, 0, 0] + noise[t, 0, 0, 0]
                yy = covariance[t, j, 1, 1] + noise[t, 0, 1, 1]
                first = sqrt(larger((1.0 + LOST) * xx, LEAST_VARIANCE))
                for a in range(d):
                    variance[a] = covariance[t, j, a, a]
                    h[0][a] = covariance[t, j, 0, a] / first
                first = first * keep_within(&h[0][0], variance, d)
                slope = h[0][1] + noise[t, 0, 0, 1] / first
                second = sqrt(larger(larger((1.0 + LOST) * yy - slope * slope, LOST * yy), LEAST_VARIANCE))
                for a in range(d):
                    variance[a] = variance[a] - h[0][a] * h[0][a]
                    h[1][a] = (covariance[t, j, 1, a] - slope * h[0][a]) / second
                second = second * keep_within(&h[1][0], variance, d)
                x = bounded(position[t, 0, 0] - mean[t, j, 0]) / first
                y = (bounded(position[t, 0, 1] - mean[t, j, 1]) - slope * x) / second
                for a in range(d):
                    mean[t, j, a] = mean[t, j, a] + h[0][a] * x
                    mean[t, j, a] = mean[t, j, a] + h[1][a] * y
                    for b in range(d):
                        covariance[t, j, a, b] = covariance[t, j, a, b] - h[0][a] * h[0][b]
                        covariance[t, j, a, b] = covariance[t, j, a, b] - h[1][a] * h[1][b]
                nis[t, j] = x * x + y * y
                root[t, j] = first * second
    return nis_array, root_array


def update_scalar(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const double[:, :, :] row,
    const double[:, :] innovation,
    const double[:, :] variance,
):
    """Update states (k, M, D) in place with a number each, Jacobian (k, M, K); return NIS and root of S, (k, M)."""
    cdef Py_ssize_t n = mean.shape[0], m = mean.shape[1], d = mean.shape[2], width = row.shape[2], t, j, a, b
    cdef double spread, own, deviation, whitened
    cdef double h[16]
    cdef double own_variance[16]
    nis_array, root_array = np.empty((n, m)), np.empty((n, m))
    cdef double[:, ::1] nis = nis_array, root = root_array
    with nogil:
        for t in range(n):
            for j in range(m):
                for a in range(d):
                    h[a] = row[t, j, 0] * covariance[t, j, 0, a]
                for b in range(1, width):
                    for a in range(d):
                        h[a] = h[a] + row[t, j, b] * covariance[t, j, b, a]
                spread = row[t, j, 0] * h[0]
                own = row[t, j, 0] * row[t, j, 0] * covariance[t, j, 0, 0]
                for a in range(1, width):
                    spread = spread + row[t, j, a] * h[a]
                    own = own + row[t, j, a] * row[t, j, a] * covariance[t, j, a, a]
                spread = larger(spread, 0.0) + variance[t, j]
                spread = spread + LOST * fabs(own)
                deviation = sqrt(larger(spread, LEAST_VARIANCE))
                for a in range(d):
                    own_variance[a] = covariance[t, j, a, a]
                    h[a] = h[a] / deviation
                deviation = deviation * keep_within(h, own_variance, d)
                whitened = bounded(innovation[t, j]) / deviation
                for a in range(d):
                    mean[t, j, a] = mean[t, j, a] + h[a] * whitened
                    for b in range(d):
                        covariance[t, j, a, b] = covariance[t, j, a, b] - h[a] * h[b]
                nis[t, j] = whitened * whitened
                root[t, j] = deviation
    return nis_array, root_array


cdef enum:
    LANES = 8  # tracks that are computed side by side


cdef inline void fetch(double* own, const double* column, Py_ssize_t lanes) noexcept nogil:
    """Copy a component of some tracks; lanes without a track hold that of the last one."""
    cdef Py_ssize_t l
    if lanes == LANES:
        memcpy(own, column, LANES * sizeof(double))
    else:
        for l in range(LANES):
            own[l] = column[l if l < lanes else lanes - 1]


cdef inline void put(double* column, const double* own, Py_ssize_t lanes) noexcept nogil:
    """Copy a component of some tracks back."""
    cdef Py_ssize_t l
    if lanes == LANES:
        memcpy(column, own, LANES * sizeof(double))
    else:
        for l in range(lanes):
            column[l] = own[l]


cdef inline void gather(double* own, const double* column, const Py_ssize_t* rows, Py_ssize_t lanes) noexcept nogil:
    """Copy a component of some bodies by their rows; lanes without a body hold that of the last one."""
    cdef Py_ssize_t l
    for l in range(LANES):
        own[l] = column[rows[l if l < lanes else lanes - 1]]


cdef inline void scatter(double* column, const double* own, const Py_ssize_t* rows, Py_ssize_t lanes) noexcept nogil:
    """Copy a component of some bodies back to their rows."""
    cdef Py_ssize_t l
    for l in range(lanes):
        column[rows[l]] = own[l]


cdef inline bint adjacent(const Py_ssize_t* rows, Py_ssize_t lanes) noexcept nogil:
    """Return whether as many tracks as there are lanes lie side by side."""
    cdef Py_ssize_t l
    cdef bint so = lanes == LANES
    for l in range(lanes):
        so = so and rows[l] == rows[0] + l
    return so


cdef inline void fetch_rows(
    double* own, const double* column, const Py_ssize_t* rows, Py_ssize_t lanes, bint together
) noexcept nogil:
    """Copy a component of some bodies by their rows, at once where those lie together."""
    if together:
        memcpy(own, &column[rows[0]], LANES * sizeof(double))
    else:
        gather(own, column, rows, lanes)


cdef inline void put_rows(
    double* column, const double* own, const Py_ssize_t* rows, Py_ssize_t lanes, bint together
) noexcept nogil:
    """Copy it back."""
    if together:
        memcpy(&column[rows[0]], own, LANES * sizeof(double))
    else:
        scatter(column, own, rows, lanes)


cdef inline void fetch_tracks(
    double[29][LANES] own, const double[:, :] columns, const Py_ssize_t* rows, Py_ssize_t lanes
) noexcept nogil:
    """Copy the mean and the triangle of P of some tracks; lanes without a track hold those of the last one."""
    cdef Py_ssize_t entry
    cdef bint together = adjacent(rows, lanes)
    for entry in range(27):
        fetch_rows(own[entry], &columns[entry, 0], rows, lanes, together)


cdef inline void put_tracks(
    double[:, :] columns, double[29][LANES] own, const Py_ssize_t* rows, Py_ssize_t lanes
) noexcept nogil:
    """Copy them back."""
    cdef Py_ssize_t entry
    cdef bint together = adjacent(rows, lanes)
    for entry in range(27):
        put_rows(&columns[entry, 0], own[entry], rows, lanes, together)


def drive_axes(double[:, ::1] columns, double limit, double floor):
    """Set the last row of columns [mean, triangle of P, variance that drives] by the accelerations, the third row."""
    cdef Py_ssize_t n = columns.shape[1], last = columns.shape[0] - 1, j
    cdef double room
    with nogil:
        for j in range(n):
            room = larger(limit - fabs(columns[2, j]), 0.0)
            columns[last, j] = larger(RAYLEIGH * (room * room), floor)


def update_axes(double[:, :] state, int size, const double[:] position, const double[:] variance, double left):
    """Update axes in place, whose columns begin with [mean, triangle of P], with a position each.

    Its variance is one for all or one each; of a variance of the state a share `left` is left at least. Returns
    innovations and their variances, (n,).
    """
    cdef Py_ssize_t n = state.shape[1], each = 1 if variance.shape[0] > 1 else 0, j, i, k, entry
    cdef double expected, least
    cdef double gain[4]
    cdef double cross[4]
    innovation_array, spread_array = np.empty(n), np.empty(n)
    cdef double[::1] innovation = innovation_array, spread = spread_array
    with nogil:
        for j in range(n):
            innovation[j] = position[j] - state[0, j]
            expected = variance[each * j]
            spread[j] = larger(state[size, j] + expected, LEAST_VARIANCE)
            for i in range(size):
                cross[i] = state[size + i, j]
                gain[i] = cross[i] / spread[j]
                state[i, j] = state[i, j] + gain[i] * innovation[j]
                state[size + i, j] = gain[i] * expected
            entry = 2 * size
            for i in range(1, size):
                least = state[entry, j] * left
                for k in range(i, size):
                    state[entry + k - i, j] = state[entry + k - i, j] - gain[i] * cross[k]
                state[entry, j] = larger(state[entry, j], least)
                entry += size - i
    return innovation_array, spread_array


def predict_plane(double[:, :] columns, const double[::1] axis, bint adapts, double limit, double floor):
    """Predict columns [mean, triangle of P, variances that drive x and y] (29, n) in place.

    An axis is given by what F, the mean's own F and Q hold (14,): rows 0, 1 and 2 of the F behind their diagonal, which
    is one, but for the last element; the upper triangle of Q. The variances follow the accelerations if they adapt. A
    negative variance of the state counts as known.
    """
    cdef Py_ssize_t n = columns.shape[1], group, t, lanes, l, i, k, first
    cdef double f01 = axis[0], f02 = axis[1], f12 = axis[2], f22 = axis[3]
    cdef double g01 = axis[4], g02 = axis[5], g12 = axis[6], g22 = axis[7]
    cdef double xx, xv, xa, vx, vv, va, ax, av, aa, least
    cdef double own[29][LANES]
    cdef int[6] known = [6, 12, 17, 21, 24, 26]  # the variances
    cdef int[6] begin = [6, 11, 15, 18, 20, 21]  # row a of the triangle lies from begin[a] + a on
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for i in range(29):
                fetch(own[i], &columns[i, t], lanes)
            for first in range(2):
                if adapts:
                    for l in range(LANES):
                        least = larger(limit - fabs(own[4 + first][l]), 0.0)
                        own[27 + first][l] = larger(RAYLEIGH * (least * least), floor)
                for l in range(LANES):
                    own[first][l] = own[first][l] + g01 * own[2 + first][l] + g02 * own[4 + first][l]
                    own[2 + first][l] = own[2 + first][l] + g12 * own[4 + first][l]
                    own[4 + first][l] = g22 * own[4 + first][l]
            predict_axis(own, 6, 8, 10, 17, 19, 24, 27, &axis[0])
            predict_axis(own, 12, 14, 16, 21, 23, 26, 28, &axis[0])
            for l in range(LANES):  # x with y
                xx = own[7][l] + f01 * own[13][l] + f02 * own[15][l]
                xv = own[9][l] + f01 * own[18][l] + f02 * own[22][l]
                xa = own[11][l] + f01 * own[20][l] + f02 * own[25][l]
                vx = own[13][l] + f12 * own[15][l]
                vv = own[18][l] + f12 * own[22][l]
                va = own[20][l] + f12 * own[25][l]
                ax, av, aa = f22 * own[15][l], f22 * own[22][l], f22 * own[25][l]
                own[7][l] = xx + xv * f01 + xa * f02
                own[9][l] = xv + xa * f12
                own[11][l] = xa * f22
                own[13][l] = vx + vv * f01 + va * f02
                own[18][l] = vv + va * f12
                own[20][l] = va * f22
                own[15][l] = ax + av * f01 + aa * f02
                own[22][l] = av + aa * f12
                own[25][l] = aa * f22
            for i in range(6):
                for l in range(LANES):
                    if own[known[i]][l] < 0.0:
                        for k in range(6):
                            own[begin[i] + k if k > i else begin[k] + i][l] = 0.0
            for i in range(29):
                put(&columns[i, t], own[i], lanes)


cdef inline void predict_axis(
    double[29][LANES] own, int xx, int xv, int xa, int vv, int va, int aa, int drive, const double* axis
) noexcept nogil:
    """Predict the covariance of an axis with itself, whose entries are given."""
    cdef Py_ssize_t l
    cdef double f01 = axis[0], f02 = axis[1], f12 = axis[2], f22 = axis[3]
    cdef double h00, h01, h02, h11, h12, h22, variance
    for l in range(LANES):
        h00 = own[xx][l] + f01 * own[xv][l] + f02 * own[xa][l]
        h01 = own[xv][l] + f01 * own[vv][l] + f02 * own[va][l]
        h02 = own[xa][l] + f01 * own[va][l] + f02 * own[aa][l]
        h11 = own[vv][l] + f12 * own[va][l]
        h12 = own[va][l] + f12 * own[aa][l]
        h22 = f22 * own[aa][l]
        variance = own[drive][l]
        own[xx][l] = h00 + h01 * f01 + h02 * f02 + variance * axis[8]
        own[xv][l] = h01 + h02 * f12 + variance * axis[9]
        own[xa][l] = h02 * f22 + variance * axis[10]
        own[vv][l] = h11 + h12 * f12 + variance * axis[11]
        own[va][l] = h12 * f22 + variance * axis[12]
        own[aa][l] = h22 * f22 + variance * axis[13]


def update_plane(
    double[:, :] columns,
    const Py_ssize_t[::1] rows,
    const double[:, :] position,
    const double[:, :, :] noise,
    const double[:] rate,
    const double[:] variance,
    double x0,
    double y0,
    double vx0,
    double vy0,
):
    """Update some columns (29, n) in place with positions (m, 2), and with range rates unless they are None.

    The sensor is at (x0, y0) and moves at (vx0, vy0). Return the NIS (m,), to which a rate that is NaN adds nothing.
    """
    cdef Py_ssize_t m = rows.shape[0], group, t, lanes, l, a, b, entry
    cdef bint rated = rate is not None
    cdef double x, y, vx, vy, distance, nearest, far, predicted
    cdef double own[29][LANES]
    cdef double measured[5][LANES]  # x, y, and their covariance
    cdef double first[LANES]
    cdef double slope[LANES]
    cdef double second[LANES]
    cdef double across[LANES]
    cdef double along[LANES]
    cdef double fit[LANES]
    cdef double spread[LANES]
    cdef double r[4][LANES]
    cdef double h[2][6][LANES]
    nis_array = np.empty(m)
    cdef double[::1] nis = nis_array
    with nogil:
        for group in range((m + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, m - t)
            fetch_tracks(own, columns, &rows[t], lanes)
            for l in range(LANES):
                entry = t + l if l < lanes else m - 1
                measured[0][l] = position[entry, 0]
                measured[1][l] = position[entry, 1]
                measured[2][l] = noise[entry, 0, 0]
                measured[3][l] = noise[entry, 0, 1]
                measured[4][l] = noise[entry, 1, 1]
            for l in range(LANES):
                first[l] = sqrt(larger((1.0 + LOST) * (own[6][l] + measured[2][l]), LEAST_VARIANCE))
                slope[l] = (own[7][l] + measured[3][l]) / first[l]
                second[l] = own[12][l] + measured[4][l]
                second[l] = larger((1.0 + LOST) * second[l] - slope[l] * slope[l], LOST * second[l])
                second[l] = sqrt(larger(second[l], LEAST_VARIANCE))
                along[l] = bounded(measured[0][l] - own[0][l]) / first[l]
                across[l] = (bounded(measured[1][l] - own[1][l]) - slope[l] * along[l]) / second[l]
                fit[l] = along[l] * along[l] + across[l] * across[l]
            for a in range(6):
                b = 7 if a == 0 else 11 + a
                for l in range(LANES):
                    h[0][a][l] = own[6 + a][l] / first[l]
                    h[1][a][l] = (own[b][l] - slope[l] * h[0][a][l]) / second[l]
            entry = 6
            for a in range(6):
                for l in range(LANES):
                    own[a][l] = own[a][l] + h[0][a][l] * along[l] + h[1][a][l] * across[l]
                for b in range(a, 6):
                    for l in range(LANES):
                        own[entry][l] = own[entry][l] - h[0][a][l] * h[0][b][l] - h[1][a][l] * h[1][b][l]
                    entry += 1
            if rated:
                for l in range(LANES):
                    entry = t + l if l < lanes else m - 1
                    measured[0][l] = rate[entry]
                    spread[l] = variance[entry]
                for l in range(LANES):
                    x, y, vx, vy = own[0][l] - x0, own[1][l] - y0, own[2][l] - vx0, own[3][l] - vy0
                    distance = sqrt(x * x + y * y)
                    nearest = larger(distance, 1e-3)
                    far = larger(distance, 1.0)
                    x, y = x / nearest, y / nearest
                    predicted = x * vx + y * vy
                    r[0][l] = (vx - predicted * x) / far
                    r[1][l] = (vy - predicted * y) / far
                    r[2][l], r[3][l] = x, y
                    measured[0][l] = measured[0][l] - predicted
                take_speed_of_pack(own, r, measured[0], spread, h[0])
                for l in range(LANES):
                    fit[l] = fit[l] + measured[0][l] * measured[0][l]
            put_tracks(columns, own, &rows[t], lanes)
            put(&nis[t], fit, lanes)
    return nis_array


def take_speed(
    double[:, :] columns,
    const Py_ssize_t[::1] rows,
    const double[:, :] row,
    const double[:] innovation,
    const double[:] variance,
):
    """Update some columns (29, n) in place with a speed each, Jacobian (4, m); return the NIS (m,), 0 where it is NaN."""
    cdef Py_ssize_t m = rows.shape[0], group, t, lanes, l, a, entry
    cdef double own[29][LANES]
    cdef double r[4][LANES]
    cdef double h[6][LANES]
    cdef double measured[LANES]
    cdef double spread[LANES]
    nis_array = np.empty(m)
    cdef double[::1] nis = nis_array
    with nogil:
        for group in range((m + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, m - t)
            fetch_tracks(own, columns, &rows[t], lanes)
            for l in range(LANES):
                entry = t + l if l < lanes else m - 1
                measured[l], spread[l] = innovation[entry], variance[entry]
                for a in range(4):
                    r[a][l] = row[a, entry]
            take_speed_of_pack(own, r, measured, spread, h)
            put_tracks(columns, own, &rows[t], lanes)
            for l in range(LANES):
                measured[l] = measured[l] * measured[l]
            put(&nis[t], measured, lanes)
    return nis_array


cdef inline void take_speed_of_pack(
    double[29][LANES] own, double[4][LANES] r, double* measured, double* spread, double[6][LANES] h
) noexcept nogil:
    """Update some tracks with a speed each, and divide the innovations by their deviations; 0 where one is NaN."""
    cdef Py_ssize_t l, a, b, entry
    cdef double certain[LANES]
    cdef Py_ssize_t[4] begin = [6, 11, 15, 18]  # row a of the triangle lies from begin[a] + a on
    for l in range(LANES):
        if not isfinite(measured[l]):
            measured[l] = r[0][l] = r[1][l] = r[2][l] = r[3][l] = 0.0
    for a in range(6):
        for l in range(LANES):
            h[a][l] = own[6 + a][l] * r[0][l]
        for b in range(1, 4):
            entry = begin[b] + a if b <= a else begin[a] + b
            for l in range(LANES):
                h[a][l] = h[a][l] + own[entry][l] * r[b][l]
    for l in range(LANES):
        certain[l] = r[0][l] * r[0][l] * own[6][l]
        certain[l] = certain[l] + r[1][l] * r[1][l] * own[12][l]
        certain[l] = certain[l] + r[2][l] * r[2][l] * own[17][l]
        certain[l] = certain[l] + r[3][l] * r[3][l] * own[21][l]
        spread[l] = spread[l] + larger(
            r[0][l] * h[0][l] + r[1][l] * h[1][l] + r[2][l] * h[2][l] + r[3][l] * h[3][l], 0.0
        )
        spread[l] = sqrt(larger(spread[l] + LOST * fabs(certain[l]), LEAST_VARIANCE))
        measured[l] = bounded(measured[l]) / spread[l]
    for a in range(6):
        for l in range(LANES):
            h[a][l] = h[a][l] / spread[l]
    entry = 6
    for a in range(6):
        for l in range(LANES):
            own[a][l] = own[a][l] + h[a][l] * measured[l]
        for b in range(a, 6):
            for l in range(LANES):
                own[entry][l] = own[entry][l] - h[a][l] * h[b][l]
            entry += 1


def plane_moments(const double[:, :] columns):
    """Return the means (n, 6) and covariances (n, 6, 6) of columns (29, n), tracks side by side."""
    cdef Py_ssize_t n = columns.shape[1], group, t, lanes, l, a, b, entry
    cdef double own[29][LANES]
    mean_array, covariance_array = np.empty((n, 6)), np.empty((n, 6, 6))
    cdef double[:, ::1] mean = mean_array
    cdef double[:, :, ::1] covariance = covariance_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for a in range(27):
                fetch(own[a], &columns[a, t], lanes)
            for l in range(lanes):
                entry = 6
                for a in range(6):
                    mean[t + l, a] = own[a][l]
                    for b in range(a, 6):
                        covariance[t + l, a, b] = covariance[t + l, b, a] = own[entry][l]
                        entry += 1
    return mean_array, covariance_array


cdef enum:
    MODELS = 8  # of an interaction
    SIZE = 9  # components of a state
    ENTRIES = 45  # of the triangle of its covariance


cdef int[SIZE] BLOCK = [0, 0, 0, 0, 1, 1, 2, 3, 3]  # place and velocity, acceleration, turn rate, jerk


def interact(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    double[:, ::1] probability,
    const double[:, :] switch,
    const unsigned char[:, :] has,
    const Py_ssize_t[:, :] source,
):
    """Mix the estimates (n, M, D) and (n, M, D, D) of models in place, and predict their probabilities (n, M).

    Of each model only the components that it has (M, D) are mixed; the others are zero, and remain so. Where it lacks
    a block of components, that of a source takes part (M, D), which is the model itself where there is none.
    """
    cdef Py_ssize_t n = mean.shape[0], t, track
    cdef int m = mean.shape[1], d = mean.shape[2], group, lanes, l, i, j, a, b, k, at, pairs = 0
    cdef double w
    cdef bint both
    cdef int[ENTRIES] row
    cdef int[ENTRIES] column
    cdef int upper[MODELS][ENTRIES]  # where the covariances of a track have what takes part for a model
    cdef int component[MODELS][SIZE]  # and its means likewise
    cdef int own[MODELS][SIZE]  # components that a model has, how many, and its pairs of them
    cdef int[MODELS] owns
    cdef int own_pair[MODELS][ENTRIES]
    cdef int[MODELS] own_pairs
    cdef double mu[MODELS][SIZE][LANES]
    cdef double p[MODELS][ENTRIES][LANES]
    cdef double weight[MODELS][LANES]
    cdef double prior[MODELS][LANES]
    cdef double predicted[MODELS][LANES]
    cdef double mixed[SIZE][LANES]
    cdef double off[SIZE][LANES]
    cdef double total[ENTRIES][LANES]
    cdef const double* here
    cdef double* there
    for j in range(m):
        owns[j] = own_pairs[j] = 0
        for a in range(d):
            component[j][a] = source[j, a] * d + a
            if has[j, a]:
                own[j][owns[j]] = a
                owns[j] += 1
    for a in range(d):
        for b in range(a, d):
            both = False
            for j in range(m):
                if has[j, a] and has[j, b]:
                    own_pair[j][own_pairs[j]] = pairs
                    own_pairs[j] += 1
                    both = True
            if both:
                row[pairs], column[pairs] = a, b
                for i in range(m):
                    upper[i][pairs] = ((source[i, a] if BLOCK[a] == BLOCK[b] else i) * d + a) * d + b
                pairs += 1
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for l in range(LANES):
                track = t + min(l, lanes - 1)
                here = &mean[track, 0, 0]
                for i in range(m):
                    prior[i][l] = probability[track, i]
                    for a in range(d):
                        mu[i][a][l] = here[component[i][a]]
                here = &covariance[track, 0, 0, 0]
                for i in range(m):
                    for k in range(pairs):
                        p[i][k][l] = here[upper[i][k]]
            for j in range(m):
                for l in range(LANES):
                    predicted[j][l] = prior[0][l] * switch[0, j]
                for i in range(1, m):
                    w = switch[i, j]
                    for l in range(LANES):
                        predicted[j][l] = predicted[j][l] + prior[i][l] * w
                for i in range(m):
                    w = switch[i, j]
                    for l in range(LANES):
                        weight[i][l] = prior[i][l] * w / predicted[j][l]
                for at in range(owns[j]):
                    a = own[j][at]
                    for l in range(LANES):
                        mixed[a][l] = weight[0][l] * mu[0][a][l]
                    for i in range(1, m):
                        for l in range(LANES):
                            mixed[a][l] = mixed[a][l] + weight[i][l] * mu[i][a][l]
                for k in range(pairs):
                    for l in range(LANES):
                        total[k][l] = 0.0
                for i in range(m):
                    for at in range(owns[j]):
                        a = own[j][at]
                        for l in range(LANES):
                            off[a][l] = mu[i][a][l] - mixed[a][l]
                    for at in range(own_pairs[j]):
                        k = own_pair[j][at]
                        a, b = row[k], column[k]
                        for l in range(LANES):
                            total[k][l] = total[k][l] + (off[a][l] * off[b][l] + p[i][k][l]) * weight[i][l]
                for l in range(lanes):
                    there = &mean[t + l, j, 0]
                    for at in range(owns[j]):
                        a = own[j][at]
                        there[a] = mixed[a][l]
                    there = &covariance[t + l, j, 0, 0]
                    for at in range(own_pairs[j]):
                        k = own_pair[j][at]
                        a, b = row[k], column[k]
                        there[a * d + b] = there[b * d + a] = total[k][l]
            for l in range(lanes):
                for j in range(m):
                    probability[t + l, j] = predicted[j][l]


def propagate(double[:, :, :] covariance, const double[:, :, :] transition, const double[:, :, :] noise):
    """Replace symmetric P (n, D, D) by F P Fᵀ + Q, for F and Q (n or 1, D, D); a negative variance counts as known.

    The numbers of each P lie together, row by row.
    """
    cdef Py_ssize_t n = covariance.shape[0], t
    cdef int d = covariance.shape[1], group, lanes, l, i, b, k, terms = 0
    cdef bint own_f = transition.shape[0] > 1, own_q = noise.shape[0] > 1
    cdef int[SIZE + 1] begin
    cdef int[SIZE * SIZE] column  # of the elements of F that are not zero for all tracks, row by row
    cdef bint[SIZE] used
    cdef double f[SIZE * SIZE][LANES]
    cdef double p[SIZE][SIZE][LANES]
    cdef double half[SIZE][SIZE][LANES]  # F P
    cdef double q[LANES]
    cdef double[LANES] element
    cdef double* here
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            if own_f or group == 0:
                terms = 0
                for k in range(d):
                    used[k] = False
                for i in range(d):
                    begin[i] = terms
                    for k in range(d):
                        for l in range(LANES):
                            element[l] = transition[t + min(l, lanes - 1) if own_f else 0, i, k]
                        if any_of(element):
                            used[k], column[terms] = True, k
                            for l in range(LANES):
                                f[terms][l] = element[l]
                            terms += 1
                begin[d] = terms
            for l in range(LANES):
                here = &covariance[t + min(l, lanes - 1), 0, 0]
                for i in range(d):
                    if used[i]:
                        for b in range(i, d):
                            p[i][b][l] = p[b][i][l] = here[i * d + b]
            for i in range(d):
                for b in range(d):
                    if used[b]:
                        weighted_sum(half[i][b], begin[i], begin[i + 1], column, f, p[b])
            for i in range(d):
                for b in range(i + 1):
                    weighted_sum(element, begin[i], begin[i + 1], column, f, half[b])
                    if own_q:
                        for l in range(LANES):
                            q[l] = noise[t + min(l, lanes - 1), b, i]
                    else:
                        for l in range(LANES):
                            q[l] = noise[0, b, i]
                    for l in range(LANES):
                        p[b][i][l] = element[l] + q[l]
            for l in range(lanes):
                here = &covariance[t + l, 0, 0]
                for i in range(d):
                    for b in range(i + 1):
                        here[b * d + i] = here[i * d + b] = p[b][i][l]
                for i in range(d):
                    if p[i][i][l] < 0.0:
                        for b in range(d):
                            here[i * d + b] = here[b * d + i] = 0.0


cdef inline void weighted_sum(
    double* total, int begin, int end, const int* chosen, double[LANES]* weight, double[LANES]* rows
) noexcept nogil:
    """Sum the chosen rows, each times its weight, of tracks side by side."""
    cdef int term, l
    if end - begin == 1:
        for l in range(LANES):
            total[l] = 0.0 + weight[begin][l] * rows[chosen[begin]][l]
    elif end - begin == 2:
        for l in range(LANES):
            total[l] = (
                0.0 + weight[begin][l] * rows[chosen[begin]][l] + weight[begin + 1][l] * rows[chosen[begin + 1]][l]
            )
    elif end - begin == 3:
        for l in range(LANES):
            total[l] = (
                0.0
                + weight[begin][l] * rows[chosen[begin]][l]
                + weight[begin + 1][l] * rows[chosen[begin + 1]][l]
                + weight[begin + 2][l] * rows[chosen[begin + 2]][l]
            )
    else:
        for l in range(LANES):
            total[l] = 0.0
        for term in range(begin, end):
            for l in range(LANES):
                total[l] = total[l] + weight[term][l] * rows[chosen[term]][l]


cdef inline bint any_of(const double* values) noexcept nogil:
    """Return whether any lane is not zero."""
    cdef int l
    cdef bint found = False
    for l in range(LANES):
        found = found or values[l] != 0.0
    return found


def moved(const double[:, :] mean, const double[:, :, :] transition):
    """Return F x (n, D) of means (n, D) for transitions (n or 1, D, D)."""
    cdef Py_ssize_t n = mean.shape[0], t
    cdef int d = mean.shape[1], i, k, at, terms = 0
    cdef bint own = transition.shape[0] > 1
    cdef double total
    cdef int[SIZE * SIZE] row
    cdef int[SIZE * SIZE] column
    predicted_array = np.zeros((n, d))
    cdef double[:, ::1] predicted = predicted_array
    with nogil:
        if not own:
            for i in range(d):
                for k in range(d):
                    if transition[0, i, k] != 0.0:
                        row[terms], column[terms] = i, k
                        terms += 1
        for t in range(n):
            for at in range(terms):
                i, k = row[at], column[at]
                predicted[t, i] = predicted[t, i] + transition[0, i, k] * mean[t, k]
            if own:
                for i in range(d):
                    total = 0.0
                    for k in range(d):
                        total = total + transition[t, i, k] * mean[t, k]
                    predicted[t, i] = total
    return predicted_array


cdef void keep_lanes_within(double* half, double* root, const double* variance, int owns) noexcept nogil:
    """As `keep_within` of tracks side by side: components by lanes, and the roots, which are changed too."""
    cdef int a, l, k, beyond = 0
    cdef double[SIZE] own
    cdef double[SIZE] most
    for k in range(owns * LANES):
        beyond |= half[k] * half[k] > variance[k]
    if not beyond:
        return
    for l in range(LANES):
        for a in range(owns):
            own[a], most[a] = half[a * LANES + l], variance[a * LANES + l]
        root[l] = root[l] * keep_within(own, most, owns)
        for a in range(owns):
            half[a * LANES + l] = own[a]


def update_models(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const unsigned char[:, :] has,
    const Py_ssize_t[::1] rows,
    const double[:, :] position,
    const double[:, :, :] noise,
    const double[:] rate,
    const double[:] variance,
    double x0,
    double y0,
    double vx0,
    double vy0,
):
    """Update some states (n, M, D) in place with positions (m, 2), and with range rates unless they are None.

    The sensor is at (x0, y0) and moves at (vx0, vy0). Return NIS and root of the determinant of S of each part
    (1 or 2, m, M), NaN where a rate was not measured.
    """
    cdef Py_ssize_t m = rows.shape[0], t, track
    cdef int models = mean.shape[1], d = mean.shape[2], group, lanes, l, j, a, b, k, pairs, owns, entry
    cdef bint rated = rate is not None
    cdef double x, y, vx, vy, distance, nearest, far, predicted
    cdef int[SIZE] own  # components that a model has
    cdef int[ENTRIES] row  # of the upper triangle, and the column, by what is in `own`
    cdef int[ENTRIES] column
    cdef int[ENTRIES] flat
    cdef int[ENTRIES] mirrored
    cdef int at[SIZE][SIZE]
    cdef double state[SIZE][LANES]
    cdef double p[ENTRIES][LANES]
    cdef double measured[5][LANES]  # x, y, and their covariance
    cdef double speed[2][LANES]  # and its variance
    cdef double first[LANES]
    cdef double slope[LANES]
    cdef double second[LANES]
    cdef double along[LANES]
    cdef double across[LANES]
    cdef double spread[LANES]
    cdef double certain[LANES]
    cdef double r[4][LANES]
    cdef double h[2][SIZE][LANES]
    cdef double own_variance[SIZE][LANES]
    cdef bint[LANES] known
    cdef double* there
    nis_array, root_array = np.empty((1 + rated, m, models)), np.empty((1 + rated, m, models))
    cdef double[:, :, ::1] nis = nis_array, root = root_array
    with nogil:
        for j in range(models):
            owns = pairs = 0
            for a in range(d):
                if has[j, a]:
                    own[owns] = a
                    owns += 1
            for a in range(owns):
                for b in range(a, owns):
                    row[pairs], column[pairs] = a, b
                    flat[pairs], mirrored[pairs] = own[a] * d + own[b], own[b] * d + own[a]
                    at[a][b] = at[b][a] = pairs
                    pairs += 1
            for group in range((m + LANES - 1) // LANES):
                t = group * LANES
                lanes = min(LANES, m - t)
                for l in range(LANES):
                    entry = t + min(l, lanes - 1)
                    measured[0][l], measured[1][l] = position[entry, 0], position[entry, 1]
                    measured[2][l], measured[3][l] = noise[entry, 0, 0], noise[entry, 0, 1]
                    measured[4][l] = noise[entry, 1, 1]
                    track = rows[entry]
                    there = &mean[track, j, 0]
                    for a in range(owns):
                        state[a][l] = there[own[a]]
                    there = &covariance[track, j, 0, 0]
                    for k in range(pairs):
                        p[k][l] = there[flat[k]]
                for l in range(LANES):
                    first[l] = sqrt(larger((1.0 + LOST) * (p[0][l] + measured[2][l]), LEAST_VARIANCE))
                for a in range(owns):
                    k = at[a][a]
                    for l in range(LANES):
                        h[0][a][l] = p[a][l] / first[l]
                        own_variance[a][l] = p[k][l]
                keep_lanes_within(&h[0][0][0], first, &own_variance[0][0], owns)
                for l in range(LANES):
                    slope[l] = h[0][1][l] + measured[3][l] / first[l]
                    second[l] = p[owns][l] + measured[4][l]
                    second[l] = larger((1.0 + LOST) * second[l] - slope[l] * slope[l], LOST * second[l])
                    second[l] = sqrt(larger(second[l], LEAST_VARIANCE))
                for a in range(owns):
                    k = at[1][a]
                    for l in range(LANES):
                        h[1][a][l] = (p[k][l] - slope[l] * h[0][a][l]) / second[l]
                        own_variance[a][l] = own_variance[a][l] - h[0][a][l] * h[0][a][l]
                keep_lanes_within(&h[1][0][0], second, &own_variance[0][0], owns)
                for l in range(LANES):
                    along[l] = bounded(measured[0][l] - state[0][l]) / first[l]
                    across[l] = (bounded(measured[1][l] - state[1][l]) - slope[l] * along[l]) / second[l]
                for a in range(owns):
                    for l in range(LANES):
                        state[a][l] = state[a][l] + h[0][a][l] * along[l] + h[1][a][l] * across[l]
                for k in range(pairs):
                    a, b = row[k], column[k]
                    for l in range(LANES):
                        p[k][l] = p[k][l] - h[0][a][l] * h[0][b][l] - h[1][a][l] * h[1][b][l]
                for l in range(lanes):
                    nis[0, t + l, j] = along[l] * along[l] + across[l] * across[l]
                    root[0, t + l, j] = first[l] * second[l]
                if rated:
                    for l in range(LANES):
                        entry = t + min(l, lanes - 1)
                        speed[0][l], speed[1][l] = rate[entry], variance[entry]
                    for l in range(LANES):
                        x, y, vx, vy = state[0][l] - x0, state[1][l] - y0, state[2][l] - vx0, state[3][l] - vy0
                        distance = sqrt(x * x + y * y)
                        nearest, far = larger(distance, 1e-3), larger(distance, 1.0)
                        x, y = x / nearest, y / nearest
                        predicted = x * vx + y * vy
                        r[0][l], r[1][l] = (vx - predicted * x) / far, (vy - predicted * y) / far
                        r[2][l], r[3][l] = x, y
                        along[l] = speed[0][l] - predicted
                    for l in range(LANES):
                        known[l] = isfinite(along[l])
                        if not known[l]:
                            along[l] = r[0][l] = r[1][l] = r[2][l] = r[3][l] = 0.0
                    for a in range(owns):
                        for l in range(LANES):
                            h[0][a][l] = r[0][l] * p[a][l]
                        for b in range(1, 4):
                            k = at[a][b]
                            for l in range(LANES):
                                h[0][a][l] = h[0][a][l] + r[b][l] * p[k][l]
                    for l in range(LANES):
                        spread[l], certain[l] = r[0][l] * h[0][0][l], r[0][l] * r[0][l] * p[0][l]
                    for a in range(1, 4):
                        k = at[a][a]
                        for l in range(LANES):
                            spread[l] = spread[l] + r[a][l] * h[0][a][l]
                            certain[l] = certain[l] + r[a][l] * r[a][l] * p[k][l]
                    for l in range(LANES):
                        spread[l] = larger(spread[l], 0.0) + speed[1][l]
                        spread[l] = sqrt(larger(spread[l] + LOST * fabs(certain[l]), LEAST_VARIANCE))
                    for a in range(owns):
                        k = at[a][a]
                        for l in range(LANES):
                            h[0][a][l] = h[0][a][l] / spread[l]
                            own_variance[a][l] = p[k][l]
                    keep_lanes_within(&h[0][0][0], spread, &own_variance[0][0], owns)
                    for l in range(LANES):
                        along[l] = bounded(along[l]) / spread[l]
                    for a in range(owns):
                        for l in range(LANES):
                            state[a][l] = state[a][l] + h[0][a][l] * along[l]
                    for k in range(pairs):
                        a, b = row[k], column[k]
                        for l in range(LANES):
                            p[k][l] = p[k][l] - h[0][a][l] * h[0][b][l]
                    for l in range(lanes):
                        nis[1, t + l, j] = along[l] * along[l]
                        root[1, t + l, j] = spread[l] if known[l] else NAN
                for l in range(lanes):
                    track = rows[t + l]
                    there = &mean[track, j, 0]
                    for a in range(owns):
                        there[own[a]] = state[a][l]
                    there = &covariance[track, j, 0, 0]
                    for k in range(pairs):
                        there[flat[k]] = there[mirrored[k]] = p[k][l]
    return nis_array, root_array


def fits(const double[:, :, ::1] nis, const double[:, :, ::1] log_root, double log_2_pi, double least):
    """Return of all parts of a measurement NIS and log likelihood less the greatest of the models, (m, M) each.

    A part is a position or, from the second on, a speed, not measured where the logarithm of its root is not a number.
    """
    cdef Py_ssize_t parts = nis.shape[0], m = nis.shape[1], models = nis.shape[2], t, j, part
    cdef double greatest, value
    sum_array, log_array = np.empty((m, models)), np.empty((m, models))
    cdef double[:, ::1] total = sum_array, likelihood = log_array
    with nogil:
        for t in range(m):
            greatest = -INFINITY
            for j in range(models):
                total[t, j] = nis[0, t, j]
                value = -log_root[0, t, j] - 0.5 * nis[0, t, j] - log_2_pi
                for part in range(1, parts):
                    total[t, j] = total[t, j] + nis[part, t, j]
                    if log_root[part, t, j] == log_root[part, t, j]:
                        value = value + (-0.5 * (nis[part, t, j] + log_2_pi) - log_root[part, t, j])
                likelihood[t, j] = larger(value, least)
                greatest = larger(greatest, likelihood[t, j])
            for j in range(models):
                likelihood[t, j] = likelihood[t, j] - greatest
    return sum_array, log_array


def weigh(
    double[:, ::1] probability,
    const Py_ssize_t[::1] rows,
    const double[:, ::1] likelihood,
    const double[:, ::1] nis,
    double least,
):
    """Weigh the models of some tracks (n, M) in place by likelihoods (m, M); return their NIS weighted as before (m,)."""
    cdef Py_ssize_t m = rows.shape[0], models = probability.shape[1], t, j
    cdef double* own
    cdef double total, weighted
    weighted_array = np.empty(m)
    cdef double[::1] mean_nis = weighted_array
    with nogil:
        for t in range(m):
            own = &probability[rows[t], 0]
            weighted = own[0] * nis[t, 0]
            total = own[0] = larger(own[0] * likelihood[t, 0], least)
            for j in range(1, models):
                weighted = weighted + own[j] * nis[t, j]
                own[j] = larger(own[j] * likelihood[t, j], least)
                total = total + own[j]
            mean_nis[t] = weighted
            for j in range(models):
                own[j] = own[j] / total
    return weighted_array


def coordinated_turn(
    const double[:, :] mean,
    double dt,
    const double[::1] rate,
    const double[::1] sine,
    const double[::1] cosine,
):
    """Return means (n, D) after a turn over dt at rates (n,), and its Jacobian (n, D, D)."""
    cdef Py_ssize_t n = mean.shape[0], d = mean.shape[1], t, i
    cdef double angle, divisor, s, c, s_w, c_w, vx, vy
    predicted_array, f_array = np.array(mean, order="C"), np.zeros((n, d, d))
    cdef double[:, ::1] predicted = predicted_array
    cdef double[:, :, ::1] f = f_array
    with nogil:
        for t in range(n):
            angle = rate[t] * dt
            if fabs(angle) < 1e-4:
                s = dt * (1.0 - angle * angle / 6.0)
                c = dt * angle / 2.0
                s_w = -dt * dt * angle / 3.0
                c_w = dt * dt / 2.0
            else:
                divisor = rate[t]
                s = sine[t] / divisor
                c = (1.0 - cosine[t]) / divisor
                s_w = (dt * cosine[t] - s) / divisor
                c_w = (dt * sine[t] - c) / divisor
            vx = mean[t, 2]
            vy = mean[t, 3]
            predicted[t, 0] = predicted[t, 0] + (s * vx - c * vy)
            predicted[t, 1] = predicted[t, 1] + (c * vx + s * vy)
            predicted[t, 2] = cosine[t] * vx - sine[t] * vy
            predicted[t, 3] = sine[t] * vx + cosine[t] * vy
            predicted[t, 6] = rate[t]
            f[t, 0, 0] = f[t, 1, 1] = f[t, 6, 6] = 1.0
            f[t, 0, 2] = f[t, 1, 3] = s
            f[t, 0, 3] = -c
            f[t, 1, 2] = c
            f[t, 2, 2] = f[t, 3, 3] = cosine[t]
            f[t, 2, 3] = -sine[t]
            f[t, 3, 2] = sine[t]
            f[t, 0, 6] = s_w * vx - c_w * vy
            f[t, 1, 6] = c_w * vx + s_w * vy
            f[t, 2, 6] = -dt * predicted[t, 3]
            f[t, 3, 6] = dt * predicted[t, 2]
    return predicted_array, f_array


def line_of_sight(const double[:, :] mean, double x0, double y0, double vx0, double vy0):
    """Return the range rate (n,) that states (n, D) predict, and its Jacobian over x, y, vx, vy (n, 4)."""
    cdef Py_ssize_t n = mean.shape[0], t
    cdef double x, y, vx, vy, distance, nearest, far
    rate_array, row_array = np.empty(n), np.empty((n, 4))
    cdef double[::1] rate = rate_array
    cdef double[:, ::1] row = row_array
    with nogil:
        for t in range(n):
            x = mean[t, 0] - x0
            y = mean[t, 1] - y0
            vx = mean[t, 2] - vx0
            vy = mean[t, 3] - vy0
            distance = sqrt(x * x + y * y)
            nearest = larger(distance, 1e-3)
            far = larger(distance, 1.0)
            x = x / nearest
            y = y / nearest
            rate[t] = x * vx + y * vy
            row[t, 0] = (vx - rate[t] * x) / far
            row[t, 1] = (vy - rate[t] * y) / far
            row[t, 2] = x
            row[t, 3] = y
    return rate_array, row_array


def combined(
    const double[:, :] probability,
    const double[:, :, :] mean,
    const double[:, :, :, :] covariance,
    const unsigned char[:] turning,
):
    """Return the mixture (n, 6) and (n, 6, 6) of what M models say of x, y, vx, vy, ax and ay.

    Their states are (n, M, D). The acceleration of those that turn is ω × v, ω their seventh component.
    """
    cdef Py_ssize_t n = mean.shape[0], m = mean.shape[1], shared = min(mean.shape[2], 6), t, j, a, b
    cdef double w, vx, vy, weight
    cdef double own[16][6]
    cdef double off[6]
    cdef double p[6][6]
    cdef double reach[2][7]
    mixed_array, spread_array = np.empty((n, 6)), np.zeros((n, 6, 6))
    cdef double[:, ::1] mixed = mixed_array
    cdef double[:, :, ::1] spread = spread_array
    with nogil:
        for t in range(n):
            for j in range(m):
                for a in range(6):
                    own[j][a] = mean[t, j, a] if a < shared else 0.0
                if turning[j]:
                    own[j][4] = -mean[t, j, 6] * mean[t, j, 3]
                    own[j][5] = mean[t, j, 6] * mean[t, j, 2]
            for a in range(6):
                mixed[t, a] = probability[t, 0] * own[0][a]
                for j in range(1, m):
                    mixed[t, a] = mixed[t, a] + probability[t, j] * own[j][a]
            for j in range(m):
                weight = probability[t, j]
                for a in range(6):
                    off[a] = own[j][a] - mixed[t, a]
                    for b in range(a, 6):
                        p[a][b] = covariance[t, j, a, b] if b < shared else 0.0
                if turning[j]:
                    vx, vy, w = mean[t, j, 2], mean[t, j, 3], mean[t, j, 6]
                    for b in range(7):
                        reach[0][b] = -w * covariance[t, j, 3, b] - vy * covariance[t, j, 6, b]
                        reach[1][b] = w * covariance[t, j, 2, b] + vx * covariance[t, j, 6, b]
                    for b in range(4):
                        p[b][4] = reach[0][b]
                        p[b][5] = reach[1][b]
                    p[4][4] = -w * reach[0][3] - vy * reach[0][6]
                    p[4][5] = w * reach[0][2] + vx * reach[0][6]
                    p[5][5] = w * reach[1][2] + vx * reach[1][6]
                for a in range(6):
                    for b in range(a, 6):
                        spread[t, a, b] = spread[t, a, b] + (off[a] * off[b] + p[a][b]) * weight
            for a in range(6):
                for b in range(a):
                    spread[t, a, b] = spread[t, b, a]
    return mixed_array, spread_array


def pair_nis(
    const double[:, :] mean,
    const double[:, :, :] covariance,
    const double[:, :] position,
    const double[:, :, :] noise,
    const double[:] predicted_rate,
    const double[:, :] row,
    const double[:] rate,
    const double[:] variance,
):
    """Return the NIS (m,) of positions and range rates, the latter with Jacobian (m, 4); NaN where none was measured."""
    cdef Py_ssize_t m = mean.shape[0], t, i, k
    cdef double state[4]
    cdef double p[4][4]
    cdef double h[4]
    nis_array = np.empty(m)
    cdef double[::1] nis = nis_array
    with nogil:
        for t in range(m):
            for i in range(4):
                state[i], h[i] = mean[t, i], row[t, i]
                for k in range(4):
                    p[i][k] = covariance[t, i, k]
            nis[t] = nis_of_pair(
                state, p, position[t, 0], position[t, 1], noise[t, 0, 0], noise[t, 0, 1], noise[t, 1, 1],
                predicted_rate[t], h, rate[t], variance[t],
            )
    return nis_array


cdef inline double nis_of_pair(
    double[4] mean,
    double[4][4] covariance,
    double x,
    double y,
    double xx,
    double xy,
    double yy,
    double predicted,
    double[4] row,
    double rate,
    double variance,
) noexcept nogil:
    """Return the NIS of a position and a range rate, of which the latter may be NaN."""
    cdef int i, k
    cdef double a, b, d, ix, iy, determinant, gain_x, gain_y, residual, spread, nis
    cdef double cross[4]
    a, b, d = covariance[0][0] + xx, covariance[0][1] + xy, covariance[1][1] + yy
    ix, iy = x - mean[0], y - mean[1]
    determinant = a * d - b * b
    nis = (d * ix * ix - 2.0 * b * ix * iy + a * iy * iy) / determinant
    for i in range(4):
        cross[i] = covariance[i][0] * row[0]
        for k in range(1, 4):
            cross[i] = cross[i] + covariance[i][k] * row[k]
    gain_x = (d * cross[0] - b * cross[1]) / determinant
    gain_y = (a * cross[1] - b * cross[0]) / determinant
    residual = rate - predicted - gain_x * ix - gain_y * iy
    spread = row[0] * cross[0]
    for k in range(1, 4):
        spread = spread + row[k] * cross[k]
    spread = spread + variance - gain_x * cross[0] - gain_y * cross[1]
    return nis + residual * residual / spread if isfinite(residual) else nis


cdef void turn_into_axes(
    const double[:, :] state,
    const double[:, :, :] covariance,
    const double[:, :] direction,
    const double[:] forward,
    double east,
    double north,
    double c,
    double s,
    double least_square,
    double[:, ::1] told,
    double[:, :, ::1] turned,
) noexcept nogil:
    cdef Py_ssize_t t, a, b, i, j
    cdef double first, second, square, way
    cdef double half[2][2]
    for t in range(state.shape[0]):
        for a in range(3):
            first = state[t, 2 * a] - (east if a == 0 else 0.0)
            second = state[t, 2 * a + 1] - (north if a == 0 else 0.0)
            told[2 * a, t] = first * c + second * s
            told[2 * a + 1, t] = second * c - first * s
        for a in range(2):
            for b in range(2):
                for j in range(2):
                    first, second = covariance[t, 2 * a, 2 * b + j], covariance[t, 2 * a + 1, 2 * b + j]
                    half[0][j] = first * c + second * s
                    half[1][j] = second * c - first * s
                for i in range(2):
                    turned[t, 2 * a + i, 2 * b] = half[i][0] * c + half[i][1] * s
                    turned[t, 2 * a + i, 2 * b + 1] = half[i][1] * c - half[i][0] * s
        for i in range(4):
            told[6 + i, t] = sqrt(larger(turned[t, i, i], 0.0))
            for j in range(i):
                turned[t, i, j] = turned[t, j, i]
        square = told[2, t] * told[2, t] + told[3, t] * told[3, t]
        told[10, t] = NAN
        if square > least_square:
            told[10, t] = (told[5, t] * told[2, t] - told[4, t] * told[3, t]) / square
        way = forward[t] if forward[t] != 0.0 else NAN
        told[11, t] = (direction[t, 0] * c + direction[t, 1] * s) * way
        told[12, t] = (direction[t, 1] * c - direction[t, 0] * s) * way


def vehicle_axes(
    const double[:, :] state,
    const double[:, :, :] covariance,
    const double[:, :] direction,
    const double[:] forward,
    double east,
    double north,
    double c,
    double s,
    double least_square,
):
    """Return what is told of k obstacles in the axes of a vehicle at (east, north), whose heading has cosine c and sine s.

    Rows of the first (13, k): x, y, vx, vy, ax, ay, the deviations of the first four, the yaw rate of those whose speed
    squared is above the least, else NaN, and the course, a vector, NaN where forward is 0. The second is the covariance
    (k, 4, 4).
    """
    cdef Py_ssize_t k = state.shape[0]
    told_array, turned_array = np.empty((13, k)), np.empty((k, 4, 4))
    cdef double[:, ::1] told = told_array
    cdef double[:, :, ::1] turned = turned_array
    with nogil:
        turn_into_axes(state, covariance, direction, forward, east, north, c, s, least_square, told, turned)
    return told_array, turned_array


def expect_detections(
    long long[:] history,
    object[long long, ndim=1, mode="strided"] scans,
    object[long long, ndim=1, mode="strided"] sensors,
    long long sensor,
    long long most,
):
    """Count a scan of a sensor, a bit, for the obstacles (k,) that it has detected before, and make room in their histories.

    The histories keep bits up to the most.
    """
    cdef Py_ssize_t k
    with nogil:
        for k in range(history.shape[0]):
            if sensors[k] & sensor:
                history[k] = history[k] << 1
                scans[k] = scans[k] + 1
            history[k] = history[k] & most


def record_detections(
    const Py_ssize_t[:] tracks,
    object[Py_ssize_t, ndim=1, mode="strided"] rows,
    object[long long, ndim=1, mode="strided"] object_id,
    object[long long, ndim=1, mode="strided"] known_id,
    object[long long, ndim=1, mode="strided"] known_sensor,
    object[long long, ndim=1, mode="strided"] obstacle,
    object[long long, ndim=1, mode="strided"] reflection_ns,
    object[long long, ndim=1, mode="strided"] obstacle_ns,
    object[long long, ndim=1, mode="strided"] history,
    object[long long, ndim=1, mode="strided"] sensors,
    long long sensor,
    long long time_ns,
):
    """Record in reflections (n,) and their obstacles (k,) that rows of a scan detected tracks (m,).

    Return how many were known by another id of the sensor, or by none.
    """
    cdef Py_ssize_t i, track, owner, renamed = 0
    with nogil:
        for i in range(tracks.shape[0]):
            track = tracks[i]
            owner = obstacle[track]
            renamed += known_id[track] != object_id[rows[i]] or known_sensor[track] != sensor
            reflection_ns[track] = obstacle_ns[owner] = time_ns
            history[owner] = history[owner] | 1
            sensors[owner] = sensors[owner] | <long long>1 << sensor
    return renamed


def lives(
    object[long long, ndim=1, mode="strided"] first_ns,
    object[long long, ndim=1, mode="strided"] last_ns,
    object[long long, ndim=1, mode="strided"] history,
    object[long long, ndim=1, mode="strided"] scans,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    long long time_ns,
    long long slack_ns,
    long long length,
):
    """Return of obstacles (k,): 0 tentative, 1 confirmed, 2 coasting; age, s; share of so many scans in which it was seen."""
    cdef Py_ssize_t k = len(first_ns), i
    cdef unsigned long long bits
    cdef int seen
    state_array, age_array, share_array = np.empty(k, np.int8), np.empty(k), np.empty(k)
    cdef signed char[::1] state = state_array
    cdef object[double, ndim=1, mode="c"] age = age_array, share = share_array
    with nogil:
        for i in range(k):
            state[i] = (1 + (time_ns - last_ns[i] > slack_ns)) if confirmed[i] else 0
            age[i] = <double>max(time_ns - first_ns[i], 0) * 1e-9
            bits, seen = <unsigned long long>history[i], 0
            while bits:
                bits = bits & (bits - 1)
                seen += 1
            share[i] = <double>seen / <double>min(scans[i] + 1, length)
    return state_array, age_array, share_array


def in_order(const Py_ssize_t[:] rows):
    """Return whether rows (m,) are 0, 1, 2 and so on."""
    cdef Py_ssize_t i
    for i in range(rows.shape[0]):
        if rows[i] != i:
            return False
    return True


def turned_towards(
    const double[:, :] direction,
    const double[:] forward,
    object[double, ndim=2, mode="strided"] velocity,
    double min_speed,
    double share,
):
    """Return directions (k, 2) after a share of the turn towards the courses of what moves, and which way it drives."""
    cdef Py_ssize_t k = direction.shape[0], t
    cdef double speed, along, towards, x, y, norm
    direction_array, forward_array = np.array(direction, order="C"), np.array(forward)
    cdef object[double, ndim=2, mode="c"] turned = direction_array
    cdef object[double, ndim=1, mode="c"] drives = forward_array
    with nogil:
        for t in range(k):
            speed = sqrt(velocity[t, 0] * velocity[t, 0] + velocity[t, 1] * velocity[t, 1])
            if speed > min_speed:
                along = velocity[t, 0] * direction[t, 0] + velocity[t, 1] * direction[t, 1]
                drives[t] = copysign(1.0, along)
                towards = copysign(1.0 / speed, along)
                x = direction[t, 0] + share * (velocity[t, 0] * towards - direction[t, 0])
                y = direction[t, 1] + share * (velocity[t, 1] * towards - direction[t, 1])
                norm = sqrt(x * x + y * y)
                turned[t, 0] = x / norm
                turned[t, 1] = y / norm
    return direction_array, forward_array


def power_series(const double[:, ::1] coefficients, double x):
    """Return Σ cₙ xⁿ of each column of coefficients (terms, k), by Horner's rule."""
    cdef Py_ssize_t terms = coefficients.shape[0], k = coefficients.shape[1], n, i
    values_array = np.array(coefficients[terms - 1])
    cdef double[::1] values = values_array
    with nogil:
        for n in range(terms - 2, -1, -1):
            for i in range(k):
                values[i] = values[i] * x + coefficients[n, i]
    return values_array


def directed_matrices(
    const double[:, :] along, const double[:, :] across, const double[:, :] direction, Py_ssize_t width
):
    """Spread two matrices (S, S), that along directions (n, 2) and that to their left, over the plane.

    Return (n, width, width), or (1, width, width) where both are the same.
    """
    cdef Py_ssize_t s = min(along.shape[0], width // 2), n = direction.shape[0], t, i, j, px, py, qx, qy
    cdef double difference, left, c, sine
    cdef bint alike = True
    cdef Py_ssize_t[4] x = [0, 2, 4, 7]
    cdef Py_ssize_t[4] y = [1, 3, 5, 8]
    for i in range(along.shape[0]):
        for j in range(along.shape[0]):
            alike = alike and along[i, j] == across[i, j]
    n = 1 if alike else n
    out_array = np.zeros((n, width, width))
    cdef double[:, :, ::1] out = out_array
    with nogil:
        for i in range(s):
            for j in range(s):
                px, py, qx, qy = x[i], y[i], x[j], y[j]
                if alike:
                    out[0, px, qx] = out[0, py, qy] = along[i, j]
                    continue
                left, difference = across[i, j], along[i, j] - across[i, j]
                for t in range(n):
                    c, sine = direction[t, 0], direction[t, 1]
                    out[t, px, qx] = left + difference * (c * c)
                    out[t, py, qy] = left + difference * (sine * sine)
                    out[t, px, qy] = out[t, py, qx] = difference * (c * sine)
    return out_array


def axis_elements(
    object[double, ndim=2, mode="c"] coefficients,
    object[Py_ssize_t, ndim=1, mode="c"] exponent,
    double dt,
    double rate,
    double intensity,
    bint mean_decays,
):
    """Return four elements of F, of the mean's own F, and six of Q (14,) of an axis whose acceleration decays.

    The series are columns of coefficients (terms, 21), before which a power of time stands by its exponent (21,).
    """
    cdef Py_ssize_t terms = len(coefficients), n, i, column
    cdef Py_ssize_t[10] chosen = [1, 2, 5, 8, 9, 10, 11, 13, 14, 17]
    cdef double value, x = -rate * dt
    elements_array = np.empty(14)
    cdef object[double, ndim=1, mode="c"] elements = elements_array
    for i in range(10):
        column = chosen[i]
        value = coefficients[terms - 1, column]
        for n in range(terms - 2, -1, -1):
            value = value * x + coefficients[n, column]
        value = pow(dt, <double>exponent[column]) * value
        if i < 4:
            elements[i] = elements[4 + i] = value
        else:
            elements[4 + i] = intensity * value
    if not mean_decays:
        elements[4], elements[5], elements[6], elements[7] = dt, dt * dt / 2.0, dt, 1.0
    return elements_array


def polar_points(
    object[double, ndim=1, mode="strided"] distance,
    object[double, ndim=1, mode="strided"] cosine,
    object[double, ndim=1, mode="strided"] sine,
    double range_variance,
    double angle_variance,
):
    """Return points (n, 2) at distances and angles, and their covariances (n, 2, 2)."""
    cdef Py_ssize_t n = len(distance), t
    cdef double across, along_c, along_s, across_c, across_s
    position_array, noise_array = np.empty((n, 2)), np.empty((n, 2, 2))
    cdef object[double, ndim=2, mode="c"] position = position_array
    cdef object[double, ndim=3, mode="c"] noise = noise_array
    with nogil:
        for t in range(n):
            position[t, 0] = distance[t] * cosine[t]
            position[t, 1] = distance[t] * sine[t]
            across = angle_variance * distance[t] * distance[t]
            along_c, along_s = range_variance * cosine[t], range_variance * sine[t]
            across_c, across_s = across * cosine[t], across * sine[t]
            noise[t, 0, 0] = along_c * cosine[t] + across_s * sine[t]
            noise[t, 1, 1] = along_s * sine[t] + across_c * cosine[t]
            noise[t, 0, 1] = noise[t, 1, 0] = (along_c - across_c) * sine[t]
    return position_array, noise_array


def placed(
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] origin,
    double east,
    double north,
    double c,
    double s,
):
    """Return points at offsets (n, 2) from an origin in the local frame (n, 2); x, y in axes with an own place (n,)."""
    cdef Py_ssize_t n = len(offset), t
    cdef double ahead, left
    position_array, x_array, y_array = np.empty((n, 2)), np.empty(n), np.empty(n)
    cdef object[double, ndim=2, mode="c"] position = position_array
    cdef object[double, ndim=1, mode="c"] x = x_array, y = y_array
    with nogil:
        for t in range(n):
            position[t, 0], position[t, 1] = offset[t, 0] + origin[0], offset[t, 1] + origin[1]
            ahead, left = position[t, 0] - east, position[t, 1] - north
            x[t], y[t] = ahead * c + left * s, left * c - ahead * s
    return position_array, x_array, y_array


def number_text(const double[:, :] values, int decimals):
    """Return numbers (n, k), rounded to decimals half to even, as comma-separated text, a line a row; NaN is empty.

    Each in units of its last decimal is below 1e15, where a double still tells one integer from the next.
    """
    cdef Py_ssize_t n = values.shape[0], width = values.shape[1], row, column, at
    cdef long long count, rest
    cdef double unit = 1.0
    cdef int place, digits
    cdef char figures[24]
    for place in range(decimals):
        unit = unit * 10.0
    text = PyBytes_FromStringAndSize(NULL, n * width * (20 + decimals) + n)
    cdef char* out = PyBytes_AS_STRING(text)
    with nogil:
        at = 0
        for row in range(n):
            for column in range(width):
                if isfinite(values[row, column]):
                    count = llrint(values[row, column] * unit)
                    rest = -count if count < 0 else count
                    digits = 0
                    while rest or digits <= decimals:
                        figures[digits] = <char>(48 + rest % 10)
                        rest = rest // 10
                        digits += 1
                    if count < 0:
                        out[at] = 45
                        at += 1
                    for place in range(digits - 1, -1, -1):
                        if place == decimals - 1:
                            out[at] = 46
                            at += 1
                        out[at] = figures[place]
                        at += 1
                out[at] = 44
                at += 1
            out[at - 1] = 10
    return text[:at]


def joined_lines(bytes start, list parts, Py_ssize_t count):
    """Return so many lines: the start, and of each part its next line, with commas between.

    Raises:
        ValueError: a part has other lines than that.
    """
    cdef Py_ssize_t width = len(parts), size = count * len(start), at = 0, line, part, length
    cdef const char* found
    cdef const char** ahead = <const char**>malloc(2 * width * sizeof(char*))
    try:
        for part in range(width):
            ahead[part] = PyBytes_AS_STRING(parts[part])
            ahead[width + part] = ahead[part] + len(parts[part])
            size += len(parts[part])
        text = PyBytes_FromStringAndSize(NULL, size)
        for line in range(count):
            memcpy(PyBytes_AS_STRING(text) + at, PyBytes_AS_STRING(start), len(start))
            at += len(start)
            for part in range(width):
                found = <const char*>memchr(ahead[part], 10, ahead[width + part] - ahead[part])
                if found == NULL:
                    raise ValueError("columns of different length")
                length = found - ahead[part]
                memcpy(PyBytes_AS_STRING(text) + at, ahead[part], length)
                PyBytes_AS_STRING(text)[at + length] = 44
                at += length + 1
                ahead[part] = found + 1
            PyBytes_AS_STRING(text)[at - 1] = 10
        if at != size:
            raise ValueError("columns of different length")
        return text
    finally:
        free(ahead)


cdef const char* HEX = b"0123456789ABCDEF"


cdef inline Py_ssize_t line_head(
    char* out, const char* stamp, Py_ssize_t before, unsigned long long number, unsigned long long extended
) noexcept nogil:
    """Write the stamp, an identifier in hex and #; return how many characters that is."""
    cdef int place, figures = 3
    memcpy(out, stamp, before)
    if number & extended:
        number, figures = number & ~extended, 8
    for place in range(figures):
        out[before + place] = HEX[number >> 4 * (figures - 1 - place) & 15]
    out[before + figures] = 35
    return before + figures + 1


def frame_lines(bytes stamp, list payloads, fd_ids, unsigned long long extended):
    """Return frames as lines of a log: the stamp, the identifier in hex, # or ##1, the data in hex.

    Identifiers with the extended bit have eight digits, others three; those in fd_ids are CAN FD frames.
    """
    cdef const unsigned char* data
    cdef const char* start = PyBytes_AS_STRING(stamp)
    cdef Py_ssize_t before = len(stamp), size = 0, at = 0, place
    cdef bytes payload
    cdef bint some_fd = bool(fd_ids)
    for _, payload in payloads:
        size += before + 12 + 2 * len(payload)
    text = PyBytes_FromStringAndSize(NULL, size)
    cdef char* out = PyBytes_AS_STRING(text)
    for can_id, payload in payloads:
        at += line_head(out + at, start, before, can_id, extended)
        if some_fd and can_id in fd_ids:
            out[at] = 35
            out[at + 1] = 49
            at += 2
        data = <const unsigned char*>PyBytes_AS_STRING(payload)
        for place in range(len(payload)):
            out[at] = HEX[data[place] >> 4]
            out[at + 1] = HEX[data[place] & 15]
            at += 2
        out[at] = 10
        at += 1
    return text[:at]


def table_lines(
    bytes stamp, const long long[:] can_id, const unsigned char[:, :] payload, unsigned long long extended
):
    """Return classic frames of one length (n, length) as `frame_lines` does."""
    cdef const char* start = PyBytes_AS_STRING(stamp)
    cdef Py_ssize_t n = payload.shape[0], length = payload.shape[1], before = len(stamp), at = 0, row, place
    text = PyBytes_FromStringAndSize(NULL, n * (before + 10 + 2 * length))
    cdef char* out = PyBytes_AS_STRING(text)
    with nogil:
        for row in range(n):
            at += line_head(out + at, start, before, can_id[row], extended)
            for place in range(length):
                out[at] = HEX[payload[row, place] >> 4]
                out[at + 1] = HEX[payload[row, place] & 15]
                at += 2
            out[at] = 10
            at += 1
    return text[:at]


cdef signed char DIGIT[256]  # what a character is worth in hex, -1 where it is no digit
for _character in range(256):
    DIGIT[_character] = -1
for _character, _value in zip(b"0123456789abcdefABCDEF", (*range(16), *range(10, 16))):
    DIGIT[_character] = _value


cdef inline long long field_number(const unsigned char* text, Py_ssize_t length, int base) noexcept nogil:
    """Return the number that some digits are, -1 where another character is among them."""
    cdef long long number = 0
    cdef Py_ssize_t k
    cdef int digit, odd = 0
    for k in range(length):
        digit = DIGIT[text[k]]
        odd |= digit | (base - 1 - digit)  # below zero where one of them is
        number = number * base + digit
    return -1 if odd < 0 else number


def frame_fields(
    const unsigned char[::1] text,
    const long long[:] starts,
    const unsigned char[::1] first,
    tuple seconds,
    tuple fraction,
    tuple identifier,
    tuple data,
):
    """Read lines (m,) of a log as long as the first, by the spans of its fields.

    Returns which are as the first between the fields, and of those that are: seconds, fraction and identifier (k,), -1
    where they are no digits, data (k, size), and whether all are digits (k,).
    """
    cdef Py_ssize_t m = starts.shape[0], row, k, at, made = 0, length = first.shape[0]
    cdef Py_ssize_t s0 = seconds[0], s1 = seconds[1], f0 = fraction[0], f1 = fraction[1], i0 = identifier[0]
    cdef Py_ssize_t i1 = identifier[1], d0 = data[0], d1 = data[1], size = (d1 - d0) // 2
    cdef const unsigned char* line
    cdef const unsigned char* shape = &first[0]
    cdef int upper, lower, odd
    alike_array, valid_array = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
    numbers_array, bytes_array = np.empty((3, m), np.int64), np.empty((m, size), np.uint8)
    cdef unsigned char[::1] alike = alike_array, valid = valid_array
    cdef long long[:, ::1] numbers = numbers_array
    cdef unsigned char[:, ::1] octets = bytes_array
    with nogil:
        for row in range(m):
            line = &text[starts[row]]
            if (
                memcmp(line, shape, s0)
                or memcmp(line + s1, shape + s1, f0 - s1)
                or memcmp(line + f1, shape + f1, i0 - f1)
                or memcmp(line + i1, shape + i1, d0 - i1)
                or memcmp(line + d1, shape + d1, length - d1)
            ):
                continue
            alike[row] = True
            numbers[0, made] = field_number(line + s0, s1 - s0, 10)
            numbers[1, made] = field_number(line + f0, f1 - f0, 10)
            numbers[2, made] = field_number(line + i0, i1 - i0, 16)
            odd = numbers[0, made] < 0 or numbers[1, made] < 0 or numbers[2, made] < 0
            odd = -odd
            for k in range(size):
                at = d0 + 2 * k
                upper, lower = DIGIT[line[at]], DIGIT[line[at + 1]]
                odd |= upper | lower
                octets[made, k] = upper << 4 | lower
            valid[made] = odd >= 0
            made += 1
    return alike_array, numbers_array[:, :made], bytes_array[:made], valid_array[:made]


def near_pairs(const double[:] x, const double[:] y, double reach):
    """Return the rows (k,) of points nearer to one another than a reach in x and in y: the later row, the earlier one."""
    cdef Py_ssize_t n = x.shape[0], later, earlier, count = 0, at = 0
    with nogil:
        for later in range(n):
            for earlier in range(later):
                count += fabs(x[later] - x[earlier]) < reach and fabs(y[later] - y[earlier]) < reach
    later_array, earlier_array = np.empty(count, np.intp), np.empty(count, np.intp)
    cdef Py_ssize_t[::1] found = later_array, before = earlier_array
    with nogil:
        for later in range(n):
            for earlier in range(later):
                if fabs(x[later] - x[earlier]) < reach and fabs(y[later] - y[earlier]) < reach:
                    found[at] = later
                    before[at] = earlier
                    at += 1
    return later_array, earlier_array


def last_rows(const long long[:] known, const long long[:] wanted):
    """Return the last row of known with each of the wanted numbers (n,), -1 where there is none, by a table of hashes."""
    cdef Py_ssize_t n = wanted.shape[0], size = 8, at, row, shift = 61
    cdef Py_ssize_t* table
    rows_array = np.empty(n, np.intp)
    cdef Py_ssize_t[::1] rows = rows_array
    while size < 2 * known.shape[0]:
        size, shift = 2 * size, shift - 1
    table = <Py_ssize_t*>malloc(size * sizeof(Py_ssize_t))
    if table == NULL:
        raise MemoryError
    with nogil:
        for at in range(size):
            table[at] = -1
        for row in range(known.shape[0]):
            at = hashed(known[row], shift)
            while table[at] >= 0 and known[table[at]] != known[row]:
                at = at + 1 & size - 1
            table[at] = row
        for row in range(n):
            at = hashed(wanted[row], shift)
            while table[at] >= 0 and known[table[at]] != wanted[row]:
                at = at + 1 & size - 1
            rows[row] = table[at]
        free(table)
    return rows_array


cdef inline Py_ssize_t hashed(long long number, Py_ssize_t shift) noexcept nogil:
    """Multiply by 2^64 over the golden ratio, and take the leading bits."""
    return <Py_ssize_t>(<unsigned long long>number * <unsigned long long>0x9E3779B97F4A7C15 >> shift)


def duplicated(const double[:] x, const double[:] y, const double[:] vx, double along, double across, double speed):
    """Return which of some obstacles (n,) have another one close by at a similar speed."""
    cdef Py_ssize_t n = x.shape[0], later, earlier
    alike_array = np.zeros(n, np.bool_)
    cdef unsigned char[::1] alike = alike_array.view(np.uint8)
    with nogil:
        for later in range(n):
            for earlier in range(later):
                if fabs(y[later] - y[earlier]) <= across and fabs(x[later] - x[earlier]) <= along:
                    if fabs(vx[later] - vx[earlier]) <= speed:
                        alike[later] = alike[earlier] = 1
    return alike_array


def mix_bodies(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const double[:, ::1] probability,
    const double[:, :] leave,
    const double[:, :] dwell,
    const double[:, :] others,
    const double[:, :] moves,
    const double[:, ::1] begins,
    const double[:] hidden,
    double stoppable,
    double least,
    double slow,
    double sharpest,
    double least_turning,
):
    """Mix the modes of bodies (8, M, n) and (8, 8, M, n) in place; return the predicted probabilities (M, n).

    A mode is left with a probability (M, 1), for the others by their dwell (M, 1), whose sum is given, too (M, 1). No
    mode is left for those that stand where all that move (M, 1) are faster than stoppable.

    Of the modes are told (3, M) the deviation of the lateral acceleration of a turn that begins where a mode is entered,
    whether they settle, and the deviation of an acceleration along the course that begins. The variances of ω and a in
    a mode grow as far as it has just been entered, that of ω as turns are not hidden (n,); the deviation of the rate of
    one that begins is the sharpest at most.
    """
    cdef Py_ssize_t m = mean.shape[1], n = mean.shape[2], group, t, lanes, i, a, b, l
    cdef double share, kept, pull, slowest, speed, stays, total
    cdef double filled[16][LANES]
    cdef double own[16][LANES]
    cdef double pooled[16][LANES]
    cdef double value[16][LANES]
    cdef double off[8][16][LANES]
    cdef double mixed[8][16][LANES]
    cdef double origin[LANES]
    cdef double pool[LANES]
    cdef double velocity[2][LANES]
    cdef double filling[LANES]
    cdef double entered, seen
    cdef double concealed[LANES]
    cdef double rate
    predicted_array = np.empty((m, n))
    cdef double[:, ::1] predicted = predicted_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for i in range(m):
                share = leave[i, 0] / others[i, 0]
                fetch(own[i], &probability[i, t], lanes)
                for l in range(LANES):
                    filled[i][l] = share * own[i][l]
            for l in range(LANES):
                pool[l] = filled[0][l]
            for i in range(1, m):
                for l in range(LANES):
                    pool[l] = pool[l] + filled[i][l]
            for l in range(LANES):
                filling[l] = pool[l]
                concealed[l] = hidden[t + (l if l < lanes else lanes - 1)]
            for i in range(m):
                pull = dwell[i, 0]
                kept = 1.0 - leave[i, 0] - pull * (leave[i, 0] / others[i, 0])
                for l in range(LANES):
                    own[i][l] = kept * own[i][l]
                    value[i][l] = own[i][l] + pull * pool[l]
                    own[i][l] = own[i][l] / value[i][l]
                    pooled[i][l] = pull / value[i][l]
                put(&predicted[i, t], value[i], lanes)
            for a in range(8):
                fetch(origin, &mean[a, 0, t], lanes)
                for i in range(m):
                    fetch(off[a][i], &mean[a, i, t], lanes)
                    for l in range(LANES):
                        off[a][i][l] = off[a][i][l] - origin[l]
                for l in range(LANES):
                    pool[l] = filled[0][l] * off[a][0][l]
                for i in range(1, m):
                    for l in range(LANES):
                        pool[l] = pool[l] + filled[i][l] * off[a][i][l]
                for i in range(m):
                    for l in range(LANES):
                        mixed[a][i][l] = off[a][i][l] * own[i][l] + pooled[i][l] * pool[l]
                        value[i][l] = mixed[a][i][l] + origin[l]
                    put(&mean[a, i, t], value[i], lanes)
            for a in range(8):
                for b in range(a, 8):
                    for i in range(m):
                        fetch(value[i], &covariance[a, b, i, t], lanes)
                        for l in range(LANES):
                            value[i][l] = value[i][l] + off[a][i][l] * off[b][i][l]
                    for l in range(LANES):
                        pool[l] = filled[0][l] * value[0][l]
                    for i in range(1, m):
                        for l in range(LANES):
                            pool[l] = pool[l] + filled[i][l] * value[i][l]
                    for i in range(m):
                        for l in range(LANES):
                            value[i][l] = value[i][l] * own[i][l] + pooled[i][l] * pool[l]
                            value[i][l] = value[i][l] - mixed[a][i][l] * mixed[b][i][l]
                        if a == 4 and b == 4:
                            fetch(velocity[0], &mean[2, i, t], lanes)
                            fetch(velocity[1], &mean[3, i, t], lanes)
                            for l in range(LANES):
                                speed = sqrt(velocity[0][l] * velocity[0][l] + velocity[1][l] * velocity[1][l])
                                rate = smaller(begins[0, i] / larger(speed, slow), sharpest)
                                seen = larger(1.0 - begins[1, i] * concealed[l], least_turning)
                                rate = rate * (seen * seen)
                                entered = pooled[i][l] * (filling[l] - filled[i][l])
                                value[i][l] = value[i][l] + entered * rate * rate
                        elif a == 5 and b == 5:
                            for l in range(LANES):
                                entered = pooled[i][l] * (filling[l] - filled[i][l])
                                value[i][l] = value[i][l] + entered * begins[2, i] * begins[2, i]
                        put(&covariance[a, b, i, t], value[i], lanes)
                        put(&covariance[b, a, i, t], value[i], lanes)
        for t in range(n):
            slowest = INFINITY
            for i in range(m):
                if moves[i, 0] > 0.0:
                    speed = sqrt(mean[2, i, t] * mean[2, i, t] + mean[3, i, t] * mean[3, i, t])
                    if speed < slowest or speed != speed:
                        slowest = speed
            for i in range(m):
                if moves[i, 0] == 0.0 and slowest > stoppable:
                    stays = (1.0 - leave[i, 0]) * probability[i, t]
                    if not stays > least:
                        stays = least
                    if stays < predicted[i, t]:
                        predicted[i, t] = stays
            total = predicted[0, t]
            for i in range(1, m):
                total = total + predicted[i, t]
            for i in range(m):
                predicted[i, t] = predicted[i, t] / total
    return predicted_array


cdef inline double smaller(double a, double b) noexcept nogil:
    """np.minimum: not a number if one is not."""
    return a if a < b or a != a else b


def step_bodies(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const double[:, :, ::1] turned,
    const double[:, ::1] modes,
    const double[:, ::1] decay,
    const double[:, :, ::1] drive,
    const double[:, :] axis,
    const double[:, :] walk,
    const double[:] hidden,
    const double[:] fade,
    const double[:, ::1] settling,
    double[:, :, :, ::1] gain,
    double dt,
    double slow,
    double turn_rate,
    double least_turning,
):
    """Predict means (8, M, n) and covariances (8, 8, M, n) of bodies in place.

    Cosines and sines of the turns are given (2, M, n). Rows of the modes (3, M): whether they move,
    deviation of the lateral acceleration, whether they settle. Shares of ω and a that are kept are given (2, M), and
    those of the biases (n,). What drives them (7, M, 1): what is added to a place's
    variance, to place with speed, to a speed, to the bias; share of the variance of ω, variance of a; dt if they steer.
    Shares that settle (M, n) and room for the gain of `BodyTransition` (4, 4, M, n) may be None.
    """
    cdef Py_ssize_t m = mean.shape[1], n = mean.shape[2], group, t, lanes, i, a, b, c, k, l
    cdef double half_step = 0.5 * dt, factor, other
    cdef bint settles = settling is not None, told = gain is not None
    cdef double state[8][LANES]
    cdef double cosine[LANES]
    cdef double sine[LANES]
    cdef double speed[LANES]
    cdef double divisor[LANES]
    cdef double along[LANES]
    cdef double share[LANES]
    cdef double spread[LANES]
    cdef double across[LANES]
    cdef double concealed[LANES]
    cdef double left_over[LANES]
    cdef double unit[2][LANES]
    cdef double left[2][LANES]
    cdef double wander[2][LANES]
    cdef double velocity[2][LANES]
    cdef double after[2][4][LANES]
    cdef double f[4][4][LANES]
    cdef double p[8][8][LANES]
    cdef double half[4][8][LANES]
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for l in range(LANES):
                k = t + (l if l < lanes else lanes - 1)
                unit[0][l] = axis[k, 0]
                unit[1][l] = axis[k, 1]
                wander[0][l] = walk[k, 0]
                wander[1][l] = walk[k, 1]
                concealed[l] = hidden[k]
                left_over[l] = fade[k]
            for l in range(LANES):
                left[0][l] = -unit[1][l]
                left[1][l] = unit[0][l]
            for i in range(m):
                for a in range(8):
                    fetch(state[a], &mean[a, i, t], lanes)
                fetch(cosine, &turned[0, i, t], lanes)
                fetch(sine, &turned[1, i, t], lanes)
                factor, other = modes[0, i], drive[6, i, 0]
                for l in range(LANES):
                    speed[l] = sqrt(state[2][l] * state[2][l] + state[3][l] * state[3][l])
                    divisor[l] = larger(speed[l], slow)
                    velocity[0][l] = cosine[l] * state[2][l] - sine[l] * state[3][l]
                    velocity[1][l] = sine[l] * state[2][l] + cosine[l] * state[3][l]
                    after[0][0][l] = cosine[l] * factor
                    after[1][1][l] = cosine[l] * factor
                    after[1][0][l] = sine[l] * factor
                    after[0][1][l] = -after[1][0][l]
                    after[0][2][l] = -velocity[1][l] * other
                    after[1][2][l] = velocity[0][l] * other
                for a in range(2):
                    for l in range(LANES):
                        along[l] = state[2 + a][l] / divisor[l]
                        along[l] = along[l] if speed[l] > slow else unit[a][l]
                        after[a][3][l] = along[l] * other
                        velocity[a][l] = velocity[a][l] * factor + after[a][3][l] * state[5][l]
                    for k in range(4):
                        for l in range(LANES):
                            f[a][k][l] = half_step * after[a][k][l]
                            f[2 + a][k][l] = after[a][k][l]
                    for l in range(LANES):
                        f[a][a][l] = f[a][a][l] + half_step * factor
                if settles:
                    fetch(share, &settling[i, t], lanes)
                    for l in range(LANES):
                        along[l] = left[0][l] * velocity[0][l] + left[1][l] * velocity[1][l]
                    for a in range(2):
                        for l in range(LANES):
                            velocity[a][l] = velocity[a][l] - share[l] * left[a][l] * along[l]
                    for k in range(4):
                        for l in range(LANES):
                            along[l] = left[0][l] * after[0][k][l] + left[1][l] * after[1][k][l]
                        for a in range(2):
                            for l in range(LANES):
                                f[2 + a][k][l] = f[2 + a][k][l] - share[l] * left[a][l] * along[l]
                for a in range(2):
                    for l in range(LANES):
                        state[a][l] = state[a][l] + half_step * (state[2 + a][l] * factor + velocity[a][l])
                        state[2 + a][l] = velocity[a][l]
                for a in range(2):
                    other = decay[a, i]
                    for l in range(LANES):
                        state[4 + a][l] = state[4 + a][l] * other
                        state[6 + a][l] = state[6 + a][l] * left_over[l]
                for a in range(8):
                    put(&mean[a, i, t], state[a], lanes)
                if told:
                    for a in range(4):
                        for k in range(4):
                            put(&gain[a, k, i, t], f[a][k], lanes)
                for a in range(8):
                    for b in range(a, 8):
                        fetch(p[a][b], &covariance[a, b, i, t], lanes)
                for a in range(2, 5):
                    for b in range(a + 1, 6):
                        for l in range(LANES):
                            p[b][a][l] = p[a][b][l]
                # F P, but for what its lower rows and the symmetry tell
                for a in range(4):
                    for c in range(2, 8):
                        for l in range(LANES):
                            half[a][c][l] = f[a][0][l] * p[2][c][l]
                        for k in range(1, 4):
                            for l in range(LANES):
                                half[a][c][l] = half[a][c][l] + f[a][k][l] * p[2 + k][c][l]
                        if a < 2:
                            for l in range(LANES):
                                half[a][c][l] = p[a][c][l] + half[a][c][l]
                for a in range(2):
                    for c in range(a, 2):
                        for l in range(LANES):
                            half[a][c][l] = f[a][0][l] * p[c][2][l]
                        for k in range(1, 4):
                            for l in range(LANES):
                                half[a][c][l] = half[a][c][l] + f[a][k][l] * p[c][2 + k][l]
                        for l in range(LANES):
                            half[a][c][l] = p[a][c][l] + half[a][c][l]
                # that times Fᵀ
                for a in range(4):
                    for b in range(a, 4):
                        for l in range(LANES):
                            p[a][b][l] = f[b][0][l] * half[a][2][l]
                        for k in range(1, 4):
                            for l in range(LANES):
                                p[a][b][l] = p[a][b][l] + f[b][k][l] * half[a][2 + k][l]
                        if b < 2:
                            for l in range(LANES):
                                p[a][b][l] = half[a][b][l] + p[a][b][l]
                    for b in range(4, 6):
                        other = decay[b - 4, i]
                        for l in range(LANES):
                            p[a][b][l] = half[a][b][l] * other
                    for b in range(6, 8):
                        for l in range(LANES):
                            p[a][b][l] = half[a][b][l] * left_over[l]
                for a in range(4, 6):
                    factor = decay[a - 4, i]
                    for b in range(a, 6):
                        other = decay[b - 4, i]
                        for l in range(LANES):
                            p[a][b][l] = p[a][b][l] * factor * other
                    for b in range(6, 8):
                        for l in range(LANES):
                            p[a][b][l] = p[a][b][l] * factor * left_over[l]
                for a in range(6, 8):
                    for b in range(a, 8):
                        for l in range(LANES):
                            p[a][b][l] = p[a][b][l] * left_over[l] * left_over[l]
                for a in range(2):
                    for l in range(LANES):
                        p[a][a][l] = p[a][a][l] + drive[0, i, 0]
                        p[a][2 + a][l] = p[a][2 + a][l] + drive[1, i, 0]
                        p[2 + a][2 + a][l] = p[2 + a][2 + a][l] + drive[2, i, 0]
                factor = drive[3, i, 0]
                for l in range(LANES):
                    across[l] = factor + wander[1][l] * dt
                    spread[l] = (wander[0][l] - wander[1][l]) * dt
                    p[6][6][l] = p[6][6][l] + (across[l] + spread[l] * unit[0][l] * unit[0][l])
                    p[7][7][l] = p[7][7][l] + (across[l] + spread[l] * unit[1][l] * unit[1][l])
                    p[6][7][l] = p[6][7][l] + spread[l] * unit[0][l] * unit[1][l]
                factor, other = modes[1, i], modes[2, i]
                for l in range(LANES):
                    speed[l] = sqrt(velocity[0][l] * velocity[0][l] + velocity[1][l] * velocity[1][l])
                    spread[l] = smaller(factor / larger(speed[l], slow), turn_rate)
                    across[l] = larger(1.0 - other * concealed[l], least_turning)
                    spread[l] = spread[l] * (across[l] * across[l])
                    p[4][4][l] = p[4][4][l] + spread[l] * spread[l] * drive[4, i, 0]
                    p[5][5][l] = p[5][5][l] + drive[5, i, 0]
                for a in range(8):
                    put(&covariance[a, a, i, t], p[a][a], lanes)
                    for b in range(a + 1, 8):
                        put(&covariance[a, b, i, t], p[a][b], lanes)
                        put(&covariance[b, a, i, t], p[a][b], lanes)


cdef inline void average_modes(
    double[8][LANES] total,
    double[8][16][LANES] off,
    double[16][LANES] weight,
    const double[:, ::1] probability,
    const double[:, :, ::1] mean,
    Py_ssize_t t,
    Py_ssize_t lanes,
) noexcept nogil:
    """Note the weights of the modes of some bodies, the means over them, and how far off the modes' own are."""
    cdef Py_ssize_t m = mean.shape[1], i, a, l
    for i in range(m):
        fetch(weight[i], &probability[i, t], lanes)
    for a in range(8):
        for i in range(m):
            fetch(off[a][i], &mean[a, i, t], lanes)
        for l in range(LANES):
            total[a][l] = weight[0][l] * off[a][0][l]
        for i in range(1, m):
            for l in range(LANES):
                total[a][l] = total[a][l] + weight[i][l] * off[a][i][l]
        for i in range(m):
            for l in range(LANES):
                off[a][i][l] = off[a][i][l] - total[a][l]


cdef inline void spread_of_modes(
    double[LANES] spread,
    const double[16][LANES] weight,
    const double[16][LANES] left,
    const double[16][LANES] right,
    const double* entry,
    Py_ssize_t m,
    Py_ssize_t n,
    Py_ssize_t lanes,
) noexcept nogil:
    """Note an entry of the covariance over the modes, from that of each (M, n) and how far off the two means are."""
    cdef Py_ssize_t i, l
    cdef double value[LANES]
    for i in range(m):
        fetch(value, &entry[i * n], lanes)
        for l in range(LANES):
            value[l] = weight[i][l] * (left[i][l] * right[i][l] + value[l])
        if i == 0:
            for l in range(LANES):
                spread[l] = value[l]
        else:
            for l in range(LANES):
                spread[l] = spread[l] + value[l]


def combine_bodies(
    const double[:, ::1] probability, const double[:, :, ::1] mean, const double[:, :, :, ::1] covariance
):
    """Return means (n, 8) and covariances (n, 8, 8) over the modes of bodies (M, n), (8, M, n) and (8, 8, M, n)."""
    cdef Py_ssize_t m = mean.shape[1], n = mean.shape[2], group, t, lanes, a, b, l
    cdef double weight[16][LANES]
    cdef double off[8][16][LANES]
    cdef double total[8][LANES]
    cdef double spread[LANES]
    mean_array, covariance_array = np.empty((n, 8)), np.empty((n, 8, 8))
    cdef double[:, ::1] overall = mean_array
    cdef double[:, :, ::1] mixed = covariance_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            average_modes(total, off, weight, probability, mean, t, lanes)
            for a in range(8):
                for l in range(lanes):
                    overall[t + l, a] = total[a][l]
                for b in range(a, 8):
                    spread_of_modes(spread, weight, off[a], off[b], &covariance[a, b, 0, t], m, n, lanes)
                    for l in range(lanes):
                        mixed[t + l, a, b] = mixed[t + l, b, a] = spread[l]
    return mean_array, covariance_array


def moments_of_bodies(
    const double[:, ::1] probability, const double[:, :, ::1] mean, const double[:, :, :, ::1] covariance
):
    """Return means (n, 8) over the modes of bodies, and the covariances of place and velocity (n, 4, 4); and what sensors
    see of them: place with bias, and velocity, (n, 4) and (n, 4, 4)."""
    cdef Py_ssize_t m = mean.shape[1], n = mean.shape[2], group, t, lanes, a, b, l, i, j
    cdef double weight[16][LANES]
    cdef double off[8][16][LANES]
    cdef double total[8][LANES]
    cdef double spread[6][6][LANES]
    cdef double half[4][6]
    cdef int[6] component = [0, 1, 2, 3, 6, 7]
    mean_array, covariance_array = np.empty((n, 8)), np.empty((n, 4, 4))
    shown_array, shown_spread_array = np.empty((n, 4)), np.empty((n, 4, 4))
    cdef double[:, ::1] overall = mean_array, shown = shown_array
    cdef double[:, :, ::1] mixed = covariance_array, shown_spread = shown_spread_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            average_modes(total, off, weight, probability, mean, t, lanes)
            for a in range(6):
                i = component[a]
                for b in range(a, 6):
                    j = component[b]
                    spread_of_modes(spread[a][b], weight, off[i], off[j], &covariance[i, j, 0, t], m, n, lanes)
            for l in range(lanes):
                for a in range(8):
                    overall[t + l, a] = total[a][l]
                for a in range(4):
                    for b in range(4):
                        mixed[t + l, a, b] = spread[min(a, b)][max(a, b)][l]
                for a in range(2):
                    shown[t + l, a] = total[a][l] + total[6 + a][l]
                    shown[t + l, 2 + a] = total[2 + a][l]
                    for b in range(6):
                        half[a][b] = spread[min(a, b)][max(a, b)][l] + spread[min(4 + a, b)][max(4 + a, b)][l]
                        half[2 + a][b] = spread[min(2 + a, b)][max(2 + a, b)][l]
                for a in range(4):
                    for b in range(2):
                        shown_spread[t + l, a, b] = half[a][b] + half[a][4 + b]
                        shown_spread[t + l, a, 2 + b] = half[a][2 + b]
    return mean_array, covariance_array, shown_array, shown_spread_array


cdef inline void narrow(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    Py_ssize_t i,
    const Py_ssize_t* rows,
    Py_ssize_t lanes,
    bint together,
    double[8][8][LANES] p,
    double[8][LANES] cross,
    double[LANES] innovation,
) noexcept nogil:
    """Move means by the cross covariance with a normalised innovation, and take its square from the covariances."""
    cdef Py_ssize_t a, b, l
    cdef double value[LANES]
    for a in range(8):
        fetch_rows(value, &mean[a, i, 0], rows, lanes, together)
        for l in range(LANES):
            value[l] = value[l] + cross[a][l] * innovation[l]
        put_rows(&mean[a, i, 0], value, rows, lanes, together)
        for b in range(a, 8):
            for l in range(LANES):
                p[a][b][l] = p[a][b][l] - cross[a][l] * cross[b][l]


cdef inline void gather_upper(
    double[:, :, :, ::1] covariance,
    Py_ssize_t i,
    const Py_ssize_t* rows,
    Py_ssize_t lanes,
    bint together,
    double[8][8][LANES] p,
) noexcept nogil:
    """Copy the upper triangles of some bodies' covariances in a mode."""
    cdef Py_ssize_t a, b
    for a in range(8):
        for b in range(a, 8):
            fetch_rows(p[a][b], &covariance[a, b, i, 0], rows, lanes, together)


cdef inline void scatter_upper(
    double[:, :, :, ::1] covariance,
    Py_ssize_t i,
    const Py_ssize_t* rows,
    Py_ssize_t lanes,
    bint together,
    double[8][8][LANES] p,
) noexcept nogil:
    """Copy upper triangles back, to both triangles."""
    cdef Py_ssize_t a, b
    for a in range(8):
        for b in range(a, 8):
            put_rows(&covariance[a, b, i, 0], p[a][b], rows, lanes, together)
            if a != b:
                put_rows(&covariance[b, a, i, 0], p[a][b], rows, lanes, together)


cdef void take_places(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const Py_ssize_t[::1] rows,
    const double[:, :] position,
    const double[:, :, :] noise,
    double[:, ::1] nis,
    double[:, ::1] area,
) noexcept nogil:
    """Update bodies with places (m, 2) and their noise (m, 2, 2); note NIS and determinant of S (M, m)."""
    cdef Py_ssize_t m = mean.shape[1], n = rows.shape[0], group, t, lanes, i, a, l, at
    cdef const Py_ssize_t* row
    cdef bint together
    cdef double p[8][8][LANES]
    cdef double cross_x[8][LANES]
    cdef double cross_y[8][LANES]
    cdef double x[LANES]
    cdef double y[LANES]
    cdef double slope[LANES]
    cdef double first[LANES]
    cdef double second[LANES]
    cdef double bias[LANES]
    cdef double xx[LANES]
    cdef double xy[LANES]
    cdef double yy[LANES]
    cdef double s, rest
    for group in range((n + LANES - 1) // LANES):
        t = group * LANES
        lanes = min(LANES, n - t)
        row = &rows[t]
        together = adjacent(row, lanes)
        for l in range(LANES):
            at = t + (l if l < lanes else lanes - 1)
            xx[l], xy[l], yy[l] = noise[at, 0, 0], noise[at, 0, 1], noise[at, 1, 1]
        for i in range(m):
            gather_upper(covariance, i, row, lanes, together, p)
            for a in range(8):
                for l in range(LANES):
                    cross_x[a][l] = p[0][a][l] + p[min(a, 6)][max(a, 6)][l]
                    cross_y[a][l] = p[min(a, 1)][max(a, 1)][l] + p[min(a, 7)][max(a, 7)][l]
            fetch_rows(x, &mean[0, i, 0], row, lanes, together)
            fetch_rows(bias, &mean[6, i, 0], row, lanes, together)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                x[l] = position[at, 0] - x[l] - bias[l]
            fetch_rows(y, &mean[1, i, 0], row, lanes, together)
            fetch_rows(bias, &mean[7, i, 0], row, lanes, together)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                y[l] = position[at, 1] - y[l] - bias[l]
            for l in range(LANES):
                s = larger(cross_x[0][l] + cross_x[6][l] + xx[l], xx[l])
                first[l] = 1.0 / sqrt(s)
                slope[l] = (cross_y[0][l] + cross_y[6][l] + xy[l]) * first[l]
                rest = cross_y[1][l] + cross_y[7][l] + yy[l] - slope[l] * slope[l]
                rest = larger(rest, (xx[l] * yy[l] - xy[l] * xy[l]) / s)
                second[l] = 1.0 / sqrt(rest)
                x[l] = x[l] * first[l]
                y[l] = (y[l] - slope[l] * x[l]) * second[l]
                bias[l] = s * rest
            put(&area[i, t], bias, lanes)
            for l in range(LANES):
                bias[l] = x[l] * x[l] + y[l] * y[l]
            put(&nis[i, t], bias, lanes)
            for a in range(8):
                for l in range(LANES):
                    cross_x[a][l] = cross_x[a][l] * first[l]
                    cross_y[a][l] = (cross_y[a][l] - slope[l] * cross_x[a][l]) * second[l]
            narrow(mean, covariance, i, row, lanes, together, p, cross_x, x)
            narrow(mean, covariance, i, row, lanes, together, p, cross_y, y)
            scatter_upper(covariance, i, row, lanes, together, p)


cdef void take_speeds(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const Py_ssize_t[::1] rows,
    const double[:, :] slope,
    const double[:, :] direction,
    const double[:] value,
    const double[:] variance,
    const double[:] lever,
    const double[:, ::1] moves,
    double unmeasured,
    double[:, ::1] nis,
    double[:, ::1] area,
) noexcept nogil:
    """Update bodies with a number each: slopes (m, 2) over places, directions over velocities, levers over turn rates.

    Add to the NIS (M, m), and multiply the determinants by S, by what changes nothing where it was not measured. Without
    slopes the number is of the velocity alone; without levers no turn rate counts, nor ever that of what stands.
    """
    cdef Py_ssize_t m = mean.shape[1], n = rows.shape[0], group, t, lanes, i, a, l, at, k, c
    cdef const Py_ssize_t* row
    cdef bint together
    cdef double p[8][8][LANES]
    cdef double cross[8][LANES]
    cdef double h[6][LANES]
    cdef double own[6][LANES]
    cdef double arm[LANES]
    cdef double x[8][LANES]
    cdef double innovation[LANES]
    cdef double root[LANES]
    cdef double s[LANES]
    cdef double known[LANES]
    cdef Py_ssize_t[6] component
    component[0], component[1], component[2], component[3], component[4], component[5] = 0, 1, 2, 3, 6, 7
    for group in range((n + LANES - 1) // LANES):
        t = group * LANES
        lanes = min(LANES, n - t)
        row = &rows[t]
        together = adjacent(row, lanes)
        for l in range(LANES):
            at = t + (l if l < lanes else lanes - 1)
            h[0][l] = h[4][l] = 0.0 if slope is None else slope[at, 0]
            h[1][l] = h[5][l] = 0.0 if slope is None else slope[at, 1]
            h[2][l], h[3][l] = direction[at, 0], direction[at, 1]
        for i in range(m):
            for a in range(8):
                fetch_rows(x[a], &mean[a, i, 0], row, lanes, together)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                innovation[l] = value[at] - (
                    h[0][l] * (x[0][l] + x[6][l]) + h[1][l] * (x[1][l] + x[7][l]) + h[2][l] * x[2][l] + h[3][l] * x[3][l]
                )
                s[l] = variance[at]
            if lever is not None:
                for l in range(LANES):
                    arm[l] = lever[t + (l if l < lanes else lanes - 1)] * moves[i, 0]
                    innovation[l] = innovation[l] - arm[l] * x[4][l]
                    arm[l] = arm[l] if fabs(innovation[l]) < INFINITY else 0.0
            for k in range(6):
                for l in range(LANES):
                    own[k][l] = h[k][l] if fabs(innovation[l]) < INFINITY else 0.0
            for l in range(LANES):
                known[l] = 1.0 if fabs(innovation[l]) < INFINITY else 0.0
                innovation[l] = innovation[l] if fabs(innovation[l]) < INFINITY else 0.0
            gather_upper(covariance, i, row, lanes, together, p)
            for a in range(8):
                for l in range(LANES):
                    cross[a][l] = p[0][a][l] * own[0][l]
                for k in range(1, 6):
                    c = component[k]
                    for l in range(LANES):
                        cross[a][l] = cross[a][l] + p[min(a, c)][max(a, c)][l] * own[k][l]
                if lever is not None:
                    for l in range(LANES):
                        cross[a][l] = cross[a][l] + p[min(a, 4)][max(a, 4)][l] * arm[l]
            for k in range(6):
                for l in range(LANES):
                    s[l] = s[l] + cross[component[k]][l] * own[k][l]
            if lever is not None:
                for l in range(LANES):
                    s[l] = s[l] + cross[4][l] * arm[l]
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                s[l] = larger(s[l], variance[at])
                root[l] = 1.0 / sqrt(s[l])
                innovation[l] = innovation[l] * root[l]
                s[l] = s[l] if known[l] > 0.0 else unmeasured
            for a in range(8):
                for l in range(LANES):
                    cross[a][l] = cross[a][l] * root[l]
            narrow(mean, covariance, i, row, lanes, together, p, cross, innovation)
            scatter_upper(covariance, i, row, lanes, together, p)
            for l in range(LANES):
                root[l] = innovation[l] * innovation[l]
            for l in range(lanes):
                nis[i, t + l] = nis[i, t + l] + root[l]
                area[i, t + l] = area[i, t + l] * s[l]


cdef void see_bodies(
    const double[:, :, ::1] mean, const double[:, ::1] probability, const Py_ssize_t[::1] rows, double[:, ::1] seen
) noexcept nogil:
    """Note where bodies are seen, place and bias, how they move, and turn, over all modes (m, 5)."""
    cdef Py_ssize_t n = rows.shape[0], modes = mean.shape[1], i, t, a, row
    cdef double place, velocity, turn
    for t in range(n):
        row = rows[t]
        for a in range(2):
            place = probability[0, row] * (mean[a, 0, row] + mean[6 + a, 0, row])
            velocity = probability[0, row] * mean[2 + a, 0, row]
            for i in range(1, modes):
                place = place + probability[i, row] * (mean[a, i, row] + mean[6 + a, i, row])
                velocity = velocity + probability[i, row] * mean[2 + a, i, row]
            seen[t, a], seen[t, 2 + a] = place, velocity
        turn = probability[0, row] * mean[4, 0, row]
        for i in range(1, modes):
            turn = turn + probability[i, row] * mean[4, i, row]
        seen[t, 4] = turn


cdef void range_rate_terms(
    const double[:, ::1] state,
    const Py_ssize_t[:] body,
    const double[:, :] offset,
    const double[:] spread,
    const double[:, :] arm,
    const double[:] value,
    const double[:] variance,
    const double[:] origin,
    const double[:] moves,
    double[:, ::1] terms,
    double[:, ::1] principal,
) noexcept nogil:
    """Note of range rates (7, n) slope and line of sight, weight, innovation and lever; and of the bodies they are of
    (4, m) how much they tell along the direction of which they tell most, and across it, and that direction."""
    cdef Py_ssize_t n = body.shape[0], m = state.shape[0], i, t
    cdef double x, y, vx, vy, distance, nearest, far, rate, weight, middle, half, root, most, least
    for t in range(m):
        principal[0, t] = principal[1, t] = principal[2, t] = 0.0
    for i in range(n):
        t = body[i]
        x, y = state[t, 0] + offset[i, 0] - origin[0], state[t, 1] + offset[i, 1] - origin[1]
        vx, vy = state[t, 2] - moves[0], state[t, 3] - moves[1]
        distance = sqrt(x * x + y * y)
        nearest, far = larger(distance, 1e-3), larger(distance, 1.0)
        x, y = x / nearest, y / nearest
        rate = x * vx + y * vy
        terms[0, i] = (vx - rate * x) / far
        terms[1, i] = (vy - rate * y) / far
        terms[2, i], terms[3, i] = x, y
        weight = 0.0
        if isfinite(value[i]):
            weight = 1.0 / (variance[i] + spread[i] * (terms[0, i] * terms[0, i] + terms[1, i] * terms[1, i]))
        terms[4, i], terms[6, i] = weight, 0.0
        if arm is not None:
            terms[6, i] = arm[i, 0] * y - arm[i, 1] * x
            rate = rate + terms[6, i] * state[t, 4]
        terms[5, i] = value[i] - rate if isfinite(value[i]) else 0.0
        principal[0, t] = principal[0, t] + weight * x * x
        principal[1, t] = principal[1, t] + weight * x * y
        principal[2, t] = principal[2, t] + weight * y * y
    for t in range(m):
        middle, half = 0.5 * (principal[0, t] + principal[2, t]), 0.5 * (principal[0, t] - principal[2, t])
        x = principal[1, t]
        root = sqrt(half * half + x * x)
        most = sqrt(0.5 + 0.5 * (fabs(half) / root if root > 0.0 else 1.0))
        least = 0.5 * fabs(x) / ((root if root > 0.0 else 1.0) * most)
        principal[0, t], principal[1, t] = middle + root, middle - root
        principal[2, t] = most if half >= 0.0 else least
        principal[3, t] = copysign(least if half >= 0.0 else most, x)


cdef void speed_component(
    const double[:, ::1] terms,
    const Py_ssize_t[:] body,
    const double[:, ::1] state,
    const double[:, ::1] principal,
    int which,
    double share,
    double least,
    double[:, ::1] slope,
    double[:, ::1] direction,
    double[::1] value,
    double[::1] variance,
    double[::1] lever,
) noexcept nogil:
    """Note what range rates tell along the directions of which they tell most (0), or across them (1)."""
    cdef Py_ssize_t n = body.shape[0], m = state.shape[0], i, t
    cdef double part, divisor
    for t in range(m):
        direction[t, 0] = -principal[3, t] if which else principal[2, t]
        direction[t, 1] = principal[2, t] if which else principal[3, t]
        slope[t, 0] = slope[t, 1] = value[t] = 0.0
        if lever is not None:
            lever[t] = 0.0
    for i in range(n):
        t = body[i]
        part = terms[4, i] * (terms[2, i] * direction[t, 0] + terms[3, i] * direction[t, 1])
        slope[t, 0] = slope[t, 0] + part * terms[0, i]
        slope[t, 1] = slope[t, 1] + part * terms[1, i]
        value[t] = value[t] + part * terms[5, i]
        if lever is not None:
            lever[t] = lever[t] + part * terms[6, i]
    for t in range(m):
        divisor = principal[which, t] if principal[which, t] > least else 1.0
        slope[t, 0] = slope[t, 0] / divisor
        slope[t, 1] = slope[t, 1] / divisor
        part = slope[t, 0] * state[t, 0] + slope[t, 1] * state[t, 1]
        part = part + (direction[t, 0] * state[t, 2] + direction[t, 1] * state[t, 3])
        value[t] = value[t] / divisor + part
        if lever is not None:
            lever[t] = lever[t] / divisor
            value[t] = value[t] + lever[t] * state[t, 4]
        if not principal[which, t] > least:
            value[t] = NAN
        variance[t] = share / divisor


cdef bint any_above(const double[:] values, double least) noexcept nogil:
    """Return whether any is greater than that."""
    cdef Py_ssize_t i
    for i in range(values.shape[0]):
        if values[i] > least:
            return True
    return False


cdef void mode_exponents(double[:, ::1] nis, double[:, ::1] log_area, double evidence) noexcept nogil:
    """Make the logarithms of determinants (M, m) those of the modes' likelihoods below the greatest, as far as they
    count."""
    cdef Py_ssize_t modes = nis.shape[0], m = nis.shape[1], i, t
    cdef double most
    for t in range(m):
        most = -0.5 * (nis[0, t] + log_area[0, t])
        for i in range(modes):
            log_area[i, t] = -0.5 * (nis[i, t] + log_area[i, t])
            most = larger(most, log_area[i, t])
        for i in range(modes):
            log_area[i, t] = evidence * (log_area[i, t] - most)


cdef void weigh_modes(
    double[:, ::1] probability,
    const Py_ssize_t[::1] rows,
    const double[:, ::1] likelihood,
    const double[:, ::1] nis,
    double least,
    double[::1] told,
) noexcept nogil:
    """Weigh the modes (M, n) of rows by their likelihoods (M, m); note the NIS over the modes before (m,)."""
    cdef Py_ssize_t n = rows.shape[0], modes = probability.shape[0], i, t, row
    cdef double total
    cdef double weight[16]
    for t in range(n):
        row = rows[t]
        total = told[t] = 0.0
        for i in range(modes):
            weight[i] = probability[i, row] * likelihood[i, t]
            total = total + weight[i] if i else weight[0]
            told[t] = told[t] + probability[i, row] * nis[i, t] if i else probability[0, row] * nis[0, t]
        for i in range(modes):
            weight[i] = larger(weight[i] / total, least)
        total = weight[0]
        for i in range(1, modes):
            total = total + weight[i]
        for i in range(modes):
            probability[i, row] = weight[i] / total


def update_bodies(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    double[:, ::1] probability,
    const Py_ssize_t[::1] rows,
    const double[:, :] position,
    const double[:, :, :] noise,
    rates,
    projections,
    const double[:, ::1] moves,
    double least_information,
    double evidence,
    double unmeasured,
    double least_probability,
):
    """Update rows (m,) of bodies (8, M, n), (8, 8, M, n) and (M, n) in place, with places (m, 2), their noise (m, 2, 2),
    range rates and components of the velocity; return the NIS (m,), weighted as the modes were."""
    cdef Py_ssize_t modes = mean.shape[1], m = rows.shape[0]
    cdef const double[:, :] along, arm
    cdef const double[:] number, spread, wander
    cdef const Py_ssize_t[:] body
    cdef double[:, ::1] state, terms, principal, slope, direction
    cdef double[::1] value, variance, lever = None
    cdef double share
    cdef int which
    area_array, told_array = np.empty((modes, m)), np.empty(m)
    cdef double[:, ::1] nis = np.empty((modes, m)), area = area_array
    cdef double[::1] told = told_array
    take_places(mean, covariance, rows, position, noise, nis, area)
    if rates is not None:
        body, along, wander, arm = rates.body, rates.offset, rates.spread, rates.arm
        number, spread, share = rates.value, rates.variance, rates.share
        state, terms, principal = np.empty((m, 5)), np.empty((7, body.shape[0])), np.empty((4, m))
        slope, direction, value, variance = np.empty((m, 2)), np.empty((m, 2)), np.empty(m), np.empty(m)
        if arm is not None:
            lever = np.empty(m)
        see_bodies(mean, probability, rows, state)
        range_rate_terms(
            state, body, along, wander, arm, number, spread, rates.origin, rates.velocity, terms, principal
        )
        for which in range(2):
            if any_above(principal[which], least_information):
                speed_component(
                    terms, body, state, principal, which, share, least_information,
                    slope, direction, value, variance, lever,
                )
                take_speeds(
                    mean, covariance, rows, slope, direction, value, variance, lever, moves, unmeasured, nis, area
                )
    for part in projections:
        along, number, spread = part.direction, part.value, part.variance
        take_speeds(mean, covariance, rows, None, along, number, spread, None, moves, unmeasured, nis, area)
    np.log(area_array, out=area_array)
    mode_exponents(nis, area, evidence)
    np.exp(area_array, out=area_array)
    weigh_modes(probability, rows, area, nis, least_probability, told)
    return told_array


def motion_of_bodies(const double[:, :] mean, double slow):
    """Return place, velocity and acceleration (n, 6) of bodies (n, 8); below the slow speed the course is shorter than
    one."""
    out_array = np.empty((mean.shape[0], 6))
    cdef double[:, ::1] out = out_array
    with nogil:
        move_bodies(mean, slow, out)
    return out_array


cdef void move_bodies(const double[:, :] mean, double slow, double[:, ::1] out) noexcept nogil:
    cdef Py_ssize_t t, a
    cdef double along
    for t in range(mean.shape[0]):
        for a in range(4):
            out[t, a] = mean[t, a]
        along = mean[t, 5] / larger(sqrt(mean[t, 2] * mean[t, 2] + mean[t, 3] * mean[t, 3]), slow)
        out[t, 4] = along * mean[t, 2] - mean[t, 4] * mean[t, 3]
        out[t, 5] = along * mean[t, 3] + mean[t, 4] * mean[t, 2]


def to_travel_axes(object[double, ndim=2, mode="strided"] vectors, object[double, ndim=2, mode="strided"] direction):
    """Return vectors (n, 2) along and across unit vectors (n, 2), positive to the left."""
    cdef Py_ssize_t n = len(vectors), t
    out_array = np.empty((n, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(n):
            out[t, 0] = vectors[t, 0] * direction[t, 0] + vectors[t, 1] * direction[t, 1]
            out[t, 1] = vectors[t, 1] * direction[t, 0] - vectors[t, 0] * direction[t, 1]
    return out_array


def from_travel_axes(
    object[double, ndim=2, mode="strided"] components,
    object[double, ndim=2, mode="strided"] direction,
):
    """Undo `to_travel_axes`."""
    cdef Py_ssize_t n = len(components), t
    out_array = np.empty((n, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(n):
            out[t, 0] = components[t, 0] * direction[t, 0] - components[t, 1] * direction[t, 1]
            out[t, 1] = components[t, 1] * direction[t, 0] + components[t, 0] * direction[t, 1]
    return out_array


cdef void face(
    double[2][LANES] observer, double[2][LANES] size, int rounds, double least, double[2][LANES] point
) noexcept nogil:
    """Note the points of ellipses with semi-axes that face observers, seen from their centres, in their axes."""
    cdef int a, turn, l
    cdef double ratio[LANES]
    cdef double norm[LANES]
    cdef double axes[2][LANES]
    cdef double eye[2][LANES]
    cdef double evolute[2][LANES]
    cdef double share[2][LANES]
    cdef double centre[2][LANES]
    cdef double away[2][LANES]
    for a in range(2):
        for l in range(LANES):
            axes[a][l], eye[a][l] = larger(size[a][l], least), fabs(observer[a][l])
    for a in range(2):
        for l in range(LANES):
            evolute[a][l] = (axes[a][l] * axes[a][l] - axes[1 - a][l] * axes[1 - a][l]) / axes[a][l]
            share[a][l] = sqrt(0.5)
    for turn in range(rounds):
        for a in range(2):
            for l in range(LANES):
                centre[a][l] = evolute[a][l] * share[a][l] * share[a][l] * share[a][l]
                away[a][l] = eye[a][l] - centre[a][l]
                point[a][l] = axes[a][l] * share[a][l] - centre[a][l]
        for l in range(LANES):
            ratio[l] = sqrt(point[0][l] * point[0][l] + point[1][l] * point[1][l])
            norm[l] = sqrt(away[0][l] * away[0][l] + away[1][l] * away[1][l])
            ratio[l] = ratio[l] / larger(norm[l], least)
        for a in range(2):
            for l in range(LANES):
                share[a][l] = (away[a][l] * ratio[l] + centre[a][l]) / axes[a][l]
                share[a][l] = smaller(larger(share[a][l], 0.0), 1.0)
        for l in range(LANES):
            norm[l] = sqrt(share[0][l] * share[0][l] + share[1][l] * share[1][l])
            norm[l] = larger(norm[l], least)
        for a in range(2):
            for l in range(LANES):
                share[a][l] = share[a][l] / norm[l]
    for a in range(2):
        for l in range(LANES):
            point[a][l] = copysign(axes[a][l] * share[a][l], observer[a][l])


def facing_points(
    const double[:, :] observer, const double[:] half_length, const double[:] half_width, int rounds, double least
):
    """Return the points (n, 2) of ellipses that face observers (n, 2), in their axes."""
    cdef Py_ssize_t n = observer.shape[0], group, t, lanes, l, at
    cdef double eye[2][LANES]
    cdef double size[2][LANES]
    cdef double point[2][LANES]
    out_array = np.empty((n, 2))
    cdef double[:, ::1] out = out_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                eye[0][l], eye[1][l] = observer[at, 0], observer[at, 1]
                size[0][l], size[1][l] = half_length[at], half_width[at]
            face(eye, size, rounds, least, point)
            for l in range(lanes):
                out[t + l, 0], out[t + l, 1] = point[0][l], point[1][l]
    return out_array


def facing_offsets(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    double east,
    double north,
    int rounds,
    double least,
):
    """Return of bodies whose reference points were so far from their centres (n, 2) how far the points that face us are."""
    cdef Py_ssize_t n = len(length), group, t, lanes, l, at
    cdef double x, y, c, s
    cdef double eye[2][LANES]
    cdef double size[2][LANES]
    cdef double point[2][LANES]
    out_array = np.empty((n, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                x, y = east - (mean[at, 0] - facing[at, 0]), north - (mean[at, 1] - facing[at, 1])
                c, s = axis[at, 0], axis[at, 1]
                eye[0][l], eye[1][l] = x * c + y * s, y * c - x * s
                size[0][l], size[1][l] = length[at] / 2.0, width[at] / 2.0
            face(eye, size, rounds, least, point)
            for l in range(lanes):
                c, s = axis[t + l, 0], axis[t + l, 1]
                out[t + l, 0] = point[0][l] * c - point[1][l] * s
                out[t + l, 1] = point[1][l] * c + point[0][l] * s
    return out_array


cdef inline bint has_size(
    double length, double length_variance, double extent, double told_length, double small, double enough
) noexcept nogil:
    """Return whether the size of a body is known: told, small, or enough of it was seen."""
    return length_variance < told_length or length < small or extent > enough


def speeds_of_slides(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] extent,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[unsigned char, ndim=1, mode="strided"] directed,
    object[long long, ndim=1, mode="strided"] last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[long long, ndim=1, mode="strided"] reflection_ns,
    double east,
    double north,
    double own_east,
    double own_north,
    int rounds,
    double least,
    double told_length,
    double small,
    double enough,
    double truck_length,
    double beside,
    double step,
):
    """Return how fast what is seen of bodies slides along them as they pass near us (n,), None: of none.

    We are at a place and move at a velocity. Only confirmed bodies of known axis count that are nearer than so far, and
    of those of known size that are no longer than a truck only those of which their last scan showed one reflection
    (m,); the points of them that face us are compared with those a step later.
    """
    cdef Py_ssize_t n = len(length), m = 0, group, first, lanes, l, t, shown
    cdef double x, y, c, s
    cdef double eye[2][LANES]
    cdef double passing[2][LANES]
    cdef double size[2][LANES]
    cdef double before[2][LANES]
    cdef double after[2][LANES]
    rows_array = np.empty(n, np.intp)
    cdef object[Py_ssize_t, ndim=1, mode="c"] rows = rows_array
    for t in range(n):
        x, y = mean[t, 0] - east, mean[t, 1] - north
        if not (x * x + y * y < beside * beside and confirmed[t] and directed[t]):
            continue
        shown = 0
        if length[t] <= truck_length and has_size(
            length[t], length_variance[t], extent[t], told_length, small, enough
        ):
            for l in range(len(body)):
                shown += body[l] == t and reflection_ns[l] == last_ns[t]
        if shown < 2:
            rows[m] = t
            m += 1
    if not m:
        return None
    out_array = np.zeros(n)
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for group in range((m + LANES - 1) // LANES):
            first = group * LANES
            lanes = min(LANES, m - first)
            for l in range(LANES):
                t = rows[first + (l if l < lanes else lanes - 1)]
                c, s = axis[t, 0], axis[t, 1]
                x, y = facing[t, 0] - (mean[t, 0] - east), facing[t, 1] - (mean[t, 1] - north)
                eye[0][l], eye[1][l] = x * c + y * s, y * c - x * s
                x, y = mean[t, 2] - own_east, mean[t, 3] - own_north
                passing[0][l], passing[1][l] = x * c + y * s, y * c - x * s
                size[0][l], size[1][l] = length[t] / 2.0, width[t] / 2.0
            face(eye, size, rounds, least, before)
            for l in range(LANES):
                eye[0][l], eye[1][l] = eye[0][l] - step * passing[0][l], eye[1][l] - step * passing[1][l]
            face(eye, size, rounds, least, after)
            for l in range(lanes):
                out[rows[first + l]] = (after[0][l] - before[0][l]) / step
    return out_array


def slide_references(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] cosine,
    object[double, ndim=1, mode="strided"] sine,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] extent,
    object[double, ndim=1, mode="strided"] alone,
    object[unsigned char, ndim=1, mode="strided"] directed,
    const Py_ssize_t[:] body,
    object[double, ndim=2, mode="strided"] offset,
    double east,
    double north,
    double own_east,
    double own_north,
    int rounds,
    double least,
    double told_length,
    double small,
    double enough,
    double turn_error,
):
    """Slide the reference points of bodies whose axes, turned by given angles, are known to where they face us.

    Return by how much (n, 2), None where no point slides; take it from what their reflections are off (m, 2), and add it
    to the reference points minus the centres. We are at a place and move at a velocity; turn rates err by so much.
    """
    cdef Py_ssize_t n = len(length), group, t, lanes, l, at, i
    cdef bint known, some = False
    cdef double x, y, c, s, rate, share
    cdef double eye[2][LANES]
    cdef double size[2][LANES]
    cdef double point[2][LANES]
    cdef double turned[2][LANES]
    cdef double before[2][LANES]
    cdef double sight[2][LANES]
    step_array = np.zeros((n, 2))
    cdef object[double, ndim=2, mode="c"] step = step_array
    with nogil:
        for group in range((n + LANES - 1) // LANES):
            t = group * LANES
            lanes = min(LANES, n - t)
            for l in range(LANES):
                at = t + (l if l < lanes else lanes - 1)
                c, s = cosine[at], sine[at]
                turned[0][l], turned[1][l] = axis[at, 0] * c - axis[at, 1] * s, axis[at, 1] * c + axis[at, 0] * s
                before[0][l] = facing[at, 0] * c - facing[at, 1] * s
                before[1][l] = facing[at, 1] * c + facing[at, 0] * s
                sight[0][l], sight[1][l] = mean[at, 0] - before[0][l] - east, mean[at, 1] - before[1][l] - north
                x, y, c, s = -sight[0][l], -sight[1][l], turned[0][l], turned[1][l]
                eye[0][l], eye[1][l] = x * c + y * s, y * c - x * s
                size[0][l], size[1][l] = length[at] / 2.0, width[at] / 2.0
            face(eye, size, rounds, least, point)
            for l in range(lanes):
                at = t + l
                known = directed[at] and (
                    alone[at] < 0.0
                    or has_size(length[at], length_variance[at], extent[at], told_length, small, enough)
                )
                if not known:
                    continue
                x, y, c, s = sight[0][l], sight[1][l], turned[0][l], turned[1][l]
                rate = (x * (mean[at, 3] - own_north) - y * (mean[at, 2] - own_east)) / larger(x * x + y * y, 1.0)
                rate = rate - mean[at, 4]
                share = larger(1.0 - turn_error / larger(fabs(rate), 1e-9), 0.0)
                step[at, 0] = share * (point[0][l] * c - point[1][l] * s - before[0][l])
                step[at, 1] = share * (point[1][l] * c + point[0][l] * s - before[1][l])
                some = some or step[at, 0] != 0.0 or step[at, 1] != 0.0
        if some:
            for i in range(body.shape[0]):
                t = body[i]
                x, y, c, s = step[t, 0], step[t, 1], axis[t, 0], axis[t, 1]
                offset[i, 0] = offset[i, 0] - (x * c + y * s)
                offset[i, 1] = offset[i, 1] - (y * c - x * s)
            for t in range(n):
                facing[t, 0] = facing[t, 0] + step[t, 0]
                facing[t, 1] = facing[t, 1] + step[t, 1]
    return step_array if some else None


def expected_places(
    const double[:, :] mean,
    const double[:, :] axis,
    const double[:, :] cosine,
    const double[:, :] sine,
    const double[:, :] across,
    const double[:, :] fade,
    const double[:] horizon,
):
    """Return where the leading reflections of bodies are expected after times (H, k, 2), by half of whose turns the
    cosines and sines are given, what share of the way across they go, and what share of their biases is left (H, k)."""
    cdef Py_ssize_t k = mean.shape[0], h, t
    cdef double vx, vy, way, x, y, c, s, ahead, aside
    out_array = np.empty((horizon.shape[0], k, 2))
    cdef double[:, :, ::1] out = out_array
    with nogil:
        for h in range(horizon.shape[0]):
            for t in range(k):
                vx, vy, c, s = mean[t, 2], mean[t, 3], cosine[h, t], sine[h, t]
                way = 1.0 + 0.5 * horizon[h] * mean[t, 5] / larger(sqrt(vx * vx + vy * vy), 1.0)
                way = horizon[h] * larger(way, 0.0)
                x, y = way * (c * vx - s * vy), way * (s * vx + c * vy)
                c, s = axis[t, 0], axis[t, 1]
                ahead, aside = x * c + y * s, (y * c - x * s) * across[h, t]
                out[h, t, 0] = mean[t, 0] + (ahead * c - aside * s) + mean[t, 6] * fade[h, t]
                out[h, t, 1] = mean[t, 1] + (aside * c + ahead * s) + mean[t, 7] * fade[h, t]
    return out_array


def hidden_motion(
    object[double, ndim=1, mode="strided"] surely,
    object[Py_ssize_t, ndim=1, mode="strided"] seen_by,
    object[Py_ssize_t, ndim=1, mode="strided"] leader,
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] drift,
    object[double, ndim=2, mode="strided"] axis,
    double drifting,
    double crossing,
):
    """Return how surely the walk of the sensors of leading reflections, −1: of none, hides how bodies move (k,); and by
    which powers of e less as they go or drift across (k,), None: nothing is hidden of any."""
    cdef Py_ssize_t k = len(leader), sensors = len(surely), t, sensor
    cdef double c, s, across, drifts
    cdef bint some = False
    hidden_array, power_array = np.empty(k), np.empty(k)
    cdef object[double, ndim=1, mode="c"] hidden = hidden_array, power = power_array
    with nogil:
        for t in range(k):
            sensor, c, s = seen_by[leader[t]], axis[t, 0], axis[t, 1]
            hidden[t] = surely[sensor if sensor >= 0 else sensors + sensor]
            some = some or hidden[t] != 0.0
            across, drifts = mean[t, 3] * c - mean[t, 2] * s, drift[t, 1] * c - drift[t, 0] * s
            across = (fabs(across) + drifting * fabs(drifts)) / crossing
            power[t] = -(across * across)
    return hidden_array, power_array if some else None


def turn_axes_of_bodies(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=3, mode="strided"] covariance,
    object[double, ndim=2, mode="strided"] axis,
    object[unsigned char, ndim=1, mode="strided"] directed,
    object[double, ndim=1, mode="strided"] ahead,
    object[double, ndim=1, mode="strided"] part,
    object[double, ndim=1, mode="strided"] passed,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=1, mode="strided"] turn,
    object[double, ndim=1, mode="strided"] turn_variance,
    object[double, ndim=2, mode="strided"] pivot,
    double course_error,
    double backing,
    double forgetting,
    double leads,
    double sideways,
    double telling,
    double unknown,
    double doubt,
    double unsure,
    double least_turn,
    double wrong,
    object[double, ndim=1, mode="strided"] tightest,
):
    """Return axes (n, 2) turned on as their bodies surely do and after a part of the turn towards the courses of the centres, all of it where the first that is
    known well is far beside the axis, and which slow ones turned round, None: none; note in place whom the course
    directs, and how fast it went ahead."""
    cdef Py_ssize_t n = len(mean), t
    cdef double vx, vy, squared, spread, known, share, speed, along, left, forward, cx, cy, x, y, norm, rate, bend, most
    cdef double beside, ax, ay, unclear, on
    cdef bint directs, tells, slow, first, told, turns, led, some = False
    out_array, turned_array = np.empty((n, 2)), np.empty(n, np.bool_)
    cdef object[double, ndim=2, mode="c"] out = out_array
    cdef object[unsigned char, ndim=1, mode="c"] turned_round = turned_array
    with nogil:
        for t in range(n):
            vx, vy = mean[t, 2], mean[t, 3]
            spread = covariance[t, 2, 2] + covariance[t, 3, 3]
            on = 0.0
            if turn is not None:
                x = mean[t, 0] - facing[t, 0] - pivot[t, 0]
                y = mean[t, 1] - facing[t, 1] - pivot[t, 1]
                rate = turn[t]
                unclear = turn_variance[t] / larger(rate * rate, least_turn)
                on = passed[t] * (rate * larger(1.0 - unsure * unclear, 0.0))
                rate = rate * larger(1.0 - doubt * unclear, 0.0)
                vx = vx - rate * y
                vy = vy + rate * x
                spread = spread + turn_variance[t] * (x * x + y * y)
            led = directed[t] and ahead[t] >= leads
            squared = vx * vx + vy * vy
            known = squared / (squared + 4.0 * spread + unknown)
            directs = spread < course_error * squared
            tells = directs or known > telling
            slow = squared < leads * leads
            first = not directed[t] and tells and slow
            told = directs and not directed[t]
            directed[t] = directed[t] or directs
            share = known * known * part[t]
            speed = sqrt(larger(squared, 1e-6))
            most = (speed + sqrt(spread)) * tightest[t]
            on = smaller(larger(on, -most), most)
            ax = axis[t, 0] - on * axis[t, 1]
            ay = axis[t, 1] + on * axis[t, 0]
            along = vx * ax + vy * ay
            left = ahead[t]
            if directs and along * along < sideways * squared:
                left = smaller(left, leads)
            if directs:
                left = left + forgetting * smaller(along, 0.0)
            turns = tells and (along < (0.0 if first else -larger(left, leads)) or left < 0.0)
            if turns:
                left = -along
            elif directs:
                left = larger(along, left)
            ahead[t] = smaller(larger(left, 0.0), backing)
            forward = -1.0 if turns else 1.0
            turned_round[t] = turns and slow
            some = some or turned_round[t]
            cx, cy = vx / speed, vy / speed
            if cx * ax + cy * ay < 0.0 and forward > 0.0:
                cx, cy = -cx, -cy
            x = forward * ax
            y = forward * ay
            beside = fabs(x * cy - y * cx)
            if told and beside > wrong:
                share = 1.0
            bend = share * beside
            if led and bend > most:
                share = share * most / larger(bend, 1e-9)
            x = x + share * (cx - x)
            y = y + share * (cy - y)
            norm = larger(sqrt(x * x + y * y), 1e-9)
            out[t, 0] = x / norm
            out[t, 1] = y / norm
    return out_array, turned_array if some else None


cdef inline bint stands(
    const double[:, :] mean,
    const unsigned char[:] directed,
    const double[:] fastest,
    Py_ssize_t body,
    double slow,
    double moved,
) noexcept nogil:
    """Whether a body stands and never showed a course."""
    return not directed[body] and fastest[body] <= moved and velocity_of(mean, body) < slow


cdef bint close_by(
    const double[:, :] shown,
    const double[:, :] axis,
    const Py_ssize_t[:] body,
    const Py_ssize_t[:] seen_ns,
    const double[:, :] offset,
    Py_ssize_t since_ns,
    Py_ssize_t one,
    Py_ssize_t other,
    double reach,
) noexcept nogil:
    """Return whether of two bodies two reflections seen since a time lie nearer to one another than a reach, and more
    were seen."""
    cdef Py_ssize_t n = body.shape[0], i, j, seen = 0
    cdef double x, y, dx, dy
    for i in range(n):
        if (body[i] == one or body[i] == other) and seen_ns[i] >= since_ns:
            seen += 1
    if seen < 3:
        return False
    for i in range(n):
        if body[i] == one and seen_ns[i] >= since_ns:
            x = shown[one, 0] + (offset[i, 0] * axis[one, 0] - offset[i, 1] * axis[one, 1])
            y = shown[one, 1] + (offset[i, 1] * axis[one, 0] + offset[i, 0] * axis[one, 1])
            for j in range(n):
                if body[j] == other and seen_ns[j] >= since_ns:
                    dx = x - (shown[other, 0] + (offset[j, 0] * axis[other, 0] - offset[j, 1] * axis[other, 1]))
                    dy = y - (shown[other, 1] + (offset[j, 1] * axis[other, 0] + offset[j, 0] * axis[other, 1]))
                    if dx * dx + dy * dy < reach * reach:
                        return True
    return False


cdef enum:  # of bodies, rows of what `bodies_to_merge` keeps of them
    STOOD  # all the time, for long
    RIDES  # may be someone on a bicycle
    TINY  # was found to be small


def bodies_to_merge(
    const double[:, :] shown,
    object[double, ndim=3, mode="strided"] spread,
    const double[:, :] mean,
    const double[:, :] axis,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    const unsigned char[:] directed,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] grown,
    object[double, ndim=1, mode="strided"] alone,
    const double[:] fastest,
    const Py_ssize_t[:] body,
    const Py_ssize_t[:] seen_ns,
    const double[:, :] offset,
    Py_ssize_t time_ns,
    Py_ssize_t stood_ns,
    Py_ssize_t since_ns,
    Py_ssize_t begun_ns,
    Py_ssize_t fresh_ns,
    Py_ssize_t late_ns,
    double slow,
    double moved,
    double apart,
    double standing_extent,
    double along,
    double across,
    double speed,
    double deviations,
    double merge_time,
    double following,
    double following_gap,
    double beside,
    double following_speed,
    double extent,
    double edge,
    tuple walker,
    double narrow,
    tuple rider,
    double rider_fastest,
    double told_length,
    double small,
    double enough,
    double course_speed,
    double course_along,
    double course_across,
    double course_apart,
    double course_faster,
    double course_drift,
    double course_time,
    double clear,
):
    """Return of each body the row of the oldest one it may be merged into, or −1, and the time alongside it takes, s."""
    cdef Py_ssize_t n = mean.shape[0], young, old
    cdef double x, y, vx, vy, ahead, aside, faster, drift, unclear, beyond, beyond_aside, squared, lane, shorter, room
    cdef double reach = larger(larger(along, course_along), larger(standing_extent, extent)) + larger(across, course_across)
    cdef double widest = larger(across, course_across), nearest = larger(along * along, standing_extent * standing_extent)
    cdef double rider_length = rider[0], rider_width = rider[1], person = walker[0]
    cdef bint moving, by_course, by_box, near, stand, late, ride
    found_array, needed_array = np.empty(n, np.int64), np.empty(n)
    cdef object[Py_ssize_t, ndim=1, mode="c"] found = found_array
    cdef double[::1] needed = needed_array, fast = np.empty(n)
    cdef double[:, ::1] place = np.empty((2, n))
    cdef object[unsigned char, ndim=2, mode="c"] kind = np.empty((3, n), np.uint8)
    with nogil:
        for young in range(n):
            fast[young] = velocity_of(mean, young)
            place[0, young], place[1, young] = shown[young, 0], shown[young, 1]
            kind[STOOD, young] = fastest[young] < slow and time_ns - first_ns[young] > stood_ns
            kind[RIDES, young] = (
                fastest[young] < rider_fastest
                and grown[young] < enough
                and not (length_variance[young] < told_length and length[young] > enough)
            )
            kind[TINY, young] = length[young] < small and (alone[young] > 1.0 or length_variance[young] > told_length)
            found[young], needed[young] = -1, merge_time
            for old in range(young):
                x, y = place[0, young] - place[0, old], place[1, young] - place[1, old]
                if not (fabs(x) < reach and fabs(y) < reach):
                    continue
                ahead = fabs(x * axis[old, 0] + y * axis[old, 1])
                aside = fabs(y * axis[old, 0] - x * axis[old, 1])
                x = shown[young, 0] - (mean[old, 0] - facing[old, 0])
                y = shown[young, 1] - (mean[old, 1] - facing[old, 1])
                beyond = fabs(x * axis[old, 0] + y * axis[old, 1])
                beyond_aside = fabs(y * axis[old, 0] - x * axis[old, 1])
                squared = ahead * ahead + aside * aside
                if not (aside < widest or squared < nearest or beyond_aside - 0.5 * width[old] < beside):
                    continue  # in no way alongside: so are most, each in its lane
                if not (ahead < larger(along, course_along) or squared < nearest or beyond < extent):
                    continue
                vx, vy = mean[young, 2] - mean[old, 2], mean[young, 3] - mean[old, 3]
                faster = fabs(vx * axis[old, 0] + vy * axis[old, 1])
                drift = fabs(vy * axis[old, 0] - vx * axis[old, 1])
                moving = smaller(fast[young], fast[old]) > course_speed
                moving = moving and drift < course_drift
                late = confirmed[young] and first_ns[young] <= late_ns
                ride = late and kind[RIDES, young] and kind[RIDES, old]
                lane = smaller(course_apart, rider_width) if ride else course_apart if late else INFINITY
                shorter = smaller(length[young], length[old])
                room = shorter if kind[TINY, young] or kind[TINY, old] else 0.5 * (length[young] + length[old])
                room = room + edge
                if ride:
                    room = smaller(room, rider_length)
                by_course = moving and aside < smaller(course_across, lane) and ahead < smaller(course_along, room)
                by_course = by_course and faster < course_faster
                by_box = moving and not ride and shorter >= small
                by_box = by_box and beyond - 0.5 * length[old] < smaller(following * fast[old], following_gap)
                by_box = by_box and beyond < extent and faster < following_speed
                by_box = by_box and (aside < course_across or beyond_aside - 0.5 * width[old] < beside) and aside < lane
                if by_course:
                    unclear = spread[young, 0, 0] + spread[young, 1, 1] + (spread[old, 0, 0] + spread[old, 1, 1])
                    unclear = 1.0 + unclear / clear
                    needed[young] = smaller(course_time * unclear, merge_time)
                elif not by_box:
                    near = ahead < smaller(along, room)
                    near = near and aside < smaller(across, smaller(lane, 0.5 * (width[young] + width[old]) + edge))
                    if near or squared < nearest:
                        stand = stands(mean, directed, fastest, young, slow, moved)
                        stand = stand and stands(mean, directed, fastest, old, slow, moved)
                        if stand and first_ns[young] <= fresh_ns:
                            continue
                        near = near or stand and (
                            squared < along * along
                            and last_ns[young] != last_ns[old]
                            or squared < standing_extent * standing_extent
                            and close_by(shown, axis, body, seen_ns, offset, since_ns, young, old, apart)
                        )
                    squared = faster * faster + drift * drift
                    unclear = spread[young, 2, 2] + spread[young, 3, 3] + (spread[old, 2, 2] + spread[old, 3, 3])
                    if fastest[young] <= moved and fastest[old] <= moved:
                        if squared > larger(slow * slow, deviations * unclear):
                            continue
                    if not (last_ns[young] >= since_ns and last_ns[old] >= since_ns and first_ns[young] > begun_ns):
                        unclear = 0.0
                    if not (near and squared < speed + deviations * unclear):
                        continue
                if kind[STOOD, young] and fastest[old] > moved or kind[STOOD, old] and fastest[young] > moved:
                    continue
                if confirmed[old] and found[young] < 0:
                    found[young] = old
            old = found[young]
            if old >= 0 and kind[TINY, young] and kind[TINY, old] and length[young] < narrow and length[old] < narrow:
                x, y = place[0, young] - place[0, old], place[1, young] - place[1, old]
                if x * x + y * y > person * person:
                    found[young] = -1
    return found_array, needed_array


def reflections_to_split(
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] rate_difference,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    const Py_ssize_t[:] leader,
    const double[:, :] mean,
    const unsigned char[:] directed,
    const double[:] fastest,
    double along,
    double extent,
    double across,
    double around,
    double speed,
    double slow,
    double moved,
):
    """Return which reflections that do not lead (n,) are too far away or of another speed for their bodies; None:
    there is none."""
    cdef Py_ssize_t n = len(offset), i
    cdef bint some = False, near
    out_array = np.empty(n, np.bool_)
    cdef object[unsigned char, ndim=1, mode="c"] out = out_array
    with nogil:
        for i in range(n):
            near = stands(mean, directed, fastest, body[i], slow, moved)
            near = near and offset[i, 0] * offset[i, 0] + offset[i, 1] * offset[i, 1] < around
            out[i] = (
                fabs(offset[i, 0]) > extent
                or fabs(offset[i, 1]) > across and not near
                or fabs(rate_difference[i]) > (speed if fabs(offset[i, 0]) > along else 2.0 * speed)
            )
        for i in range(leader.shape[0]):
            out[leader[i]] = False
        for i in range(n):
            some = some or out[i]
    return out_array if some else None


def mark_detected(
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] keys,
    object[Py_ssize_t, ndim=1, mode="strided"] sensor_of,
    object[Py_ssize_t, ndim=1, mode="strided"] object_id,
    object[Py_ssize_t, ndim=1, mode="strided"] reflection_last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] history,
    object[Py_ssize_t, ndim=1, mode="strided"] sensors,
    Py_ssize_t sensor,
    Py_ssize_t time_ns,
):
    """Mark in place reflections and bodies as detected by a sensor; return the detections (m,) whose keys, if there are
    any, are not their reflections' ids."""
    cdef Py_ssize_t m = len(row), i
    renamed = []
    for i in range(m):
        if keys is not None and (object_id[row[i]] != keys[i] or sensor_of[row[i]] != sensor):
            renamed.append(i)
        else:
            sensor_of[row[i]] = sensor
        reflection_last_ns[row[i]] = time_ns
        history[body[i]] |= 1
        sensors[body[i]] |= <Py_ssize_t>1 << sensor
    return renamed


cdef inline double velocity_of(const double[:, :] mean, Py_ssize_t t) noexcept nogil:
    """Return the speed of a body."""
    return sqrt(mean[t, 2] * mean[t, 2] + mean[t, 3] * mean[t, 3])


def beyond_bodies(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] extent,
    object[unsigned char, ndim=1, mode="strided"] directed,
    double told_length,
    double small,
    double enough,
    double margin,
):
    """Return how far the biases of bodies reach beyond their boxes, along and across (n, 2), and whether any does."""
    cdef Py_ssize_t n = len(mean), t
    cdef bint any_does = False
    cdef double value, half
    cdef int a
    out_array = np.empty((n, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(n):
            for a in range(2):
                if a == 0:
                    value, half = mean[t, 6] * axis[t, 0] + mean[t, 7] * axis[t, 1], 0.5 * length[t]
                    if directed[t] and has_size(
                        length[t], length_variance[t], extent[t], told_length, small, enough
                    ):
                        value = value + (facing[t, 0] * axis[t, 0] + facing[t, 1] * axis[t, 1])
                        half = half + margin
                else:
                    value, half = mean[t, 7] * axis[t, 0] - mean[t, 6] * axis[t, 1], 0.5 * width[t]
                out[t, a] = value - smaller(larger(value, -half), half)
                any_does = any_does or out[t, a] != 0.0
    return out_array, any_does


def follow_biases(
    double[:, :] drift,
    const double[:, :] axis,
    const double[:, :] beyond,
    const double[:] dt,
    const double[:] near,
    const double[:] share,
    double least_time,
    double least_drift,
    double opening_time,
):
    """Return by which steps reference points follow biases (n, 2), and how fast bodies may move that way (n, 2).

    Their drift (n, 2) is changed in place.
    """
    cdef Py_ssize_t n = dt.shape[0], t
    cdef double along, across, since, opening, mean
    cdef int a
    step_array, spread_array = np.empty((n, 2)), np.empty((n, 2))
    cdef double[:, ::1] step = step_array
    cdef double[:, ::1] spread = spread_array
    with nogil:
        for t in range(n):
            along, across = near[t] * beyond[t, 0], near[t] * beyond[t, 1]
            step[t, 0] = along * axis[t, 0] - across * axis[t, 1]
            step[t, 1] = across * axis[t, 0] + along * axis[t, 1]
            since, opening = larger(dt[t], least_time), sqrt(dt[t] / opening_time)
            for a in range(2):
                mean = drift[t, a] + share[t] * (step[t, a] / since - drift[t, a])
                drift[t, a] = mean if fabs(mean) > least_drift else 0.0
                spread[t, a] = opening * drift[t, a]
    return step_array, spread_array


def settle_bodies(
    double[:, :, ::1] mean,
    double[:, :, :, ::1] covariance,
    const double[:, ::1] moves,
    const double[:, :] step,
    const double[:, :] spread,
):
    """Move in place by steps (n, 2) what biases had to the places of bodies, in all modes (8, M, n).

    By spreads (n, 2), if there are any, it is open again, in covariances (8, 8, M, n), how fast they move in the modes
    that do (M, 1).
    """
    cdef Py_ssize_t i, t
    cdef int a, b
    with nogil:
        for a in range(2):
            for i in range(mean.shape[1]):
                for t in range(mean.shape[2]):
                    mean[a, i, t] = mean[a, i, t] + step[t, a]
                    mean[6 + a, i, t] = mean[6 + a, i, t] - step[t, a]
            for b in range(2 if spread is not None else 0):
                for i in range(mean.shape[1]):
                    for t in range(mean.shape[2]):
                        covariance[2 + a, 2 + b, i, t] = (
                            covariance[2 + a, 2 + b, i, t] + moves[i, 0] * (spread[t, a] * spread[t, b])
                        )


def reference_targets(
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] fastest,
    Py_ssize_t since_ns,
    double course_speed,
    double least_normal,
):
    """Return where on bodies (k, 2) their reference points belong, along and across, from those of their reflections."""
    cdef Py_ssize_t n = len(body), k = len(axis), i, t
    cdef double ahead, aside, towards, first, second, away, seen_end, from_end, share, nearer
    out_array, end_array, count_array = np.zeros((k, 2)), np.empty((2, k)), np.zeros(k, np.intp)
    sight_array = np.empty((k, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array, end = end_array, sight = sight_array
    cdef object[Py_ssize_t, ndim=1, mode="c"] count = count_array
    with nogil:
        for t in range(k):
            ahead = facing[t, 0] * axis[t, 0] + facing[t, 1] * axis[t, 1]
            aside = facing[t, 1] * axis[t, 0] - facing[t, 0] * axis[t, 1]
            first, second = ahead / (length[t] * length[t]), aside / (width[t] * width[t])
            away = larger(sqrt(first * first + second * second), least_normal)
            sight[t, 0], sight[t, 1] = first / away, second / away
            end[0, t] = end[1, t] = -INFINITY
        for i in range(n):
            t = body[i]
            if last_ns[i] >= since_ns:
                count[t] += 1
                out[t, 0] = out[t, 0] + offset[i, 0]
                out[t, 1] = out[t, 1] + offset[i, 1]
                ahead = facing[t, 0] * axis[t, 0] + facing[t, 1] * axis[t, 1]
                end[0, t] = larger(end[0, t], copysign(1.0, ahead) * offset[i, 0])
                end[1, t] = larger(end[1, t], sight[t, 0] * offset[i, 0] + sight[t, 1] * offset[i, 1])
        for t in range(k):
            out[t, 0] = out[t, 0] / (count[t] if count[t] > 1 else 1)
            out[t, 1] = out[t, 1] / (count[t] if count[t] > 1 else 1)
            ahead = facing[t, 0] * axis[t, 0] + facing[t, 1] * axis[t, 1]
            aside = facing[t, 1] * axis[t, 0] - facing[t, 0] * axis[t, 1]
            towards = copysign(1.0, ahead)
            first, second = ahead / (length[t] * length[t]), aside / (width[t] * width[t])
            first, second = first * first, second * second
            seen_end, share = 0.0, 0.0
            if count[t] > 1 and fastest[t] > course_speed:
                seen_end, share = end[0, t], first / larger(first + second, least_normal)
            from_end = towards * (seen_end - 0.5 * length[t] + fabs(ahead))
            out[t, 0] = out[t, 0] + share * (from_end - out[t, 0])
            nearer = 0.0
            if count[t] > 0 and fastest[t] <= course_speed:
                nearer = end[1, t] - (sight[t, 0] * out[t, 0] + sight[t, 1] * out[t, 1])
            out[t, 0] = out[t, 0] + nearer * sight[t, 0]
            out[t, 1] = out[t, 1] + nearer * sight[t, 1]
    return out_array


def measure_bodies(
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=3, mode="strided"] noise,
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] spread,
    double least,
):
    """Return the bodies (m,) that are measured, the first detection of each, which of them each detection is of, and
    their places (m, 2) with covariances (m, 2, 2)."""
    cdef Py_ssize_t n = len(body), m = 0, i, t
    cdef double a, b, d, determinant, x, y
    cdef Py_ssize_t most = -1
    for i in range(n):
        most = max(most, body[i])
    slot_array, group_array = np.empty(most + 1, np.intp), np.empty(n, np.intp)
    cdef object[Py_ssize_t, ndim=1, mode="c"] slot = slot_array, group = group_array
    for t in range(most + 1):
        slot[t] = -1
    for i in range(n):
        if slot[body[i]] < 0:
            m += 1
            slot[body[i]] = i
    rows_array, first_array = np.empty(m, np.intp), np.empty(m, np.intp)
    cdef object[Py_ssize_t, ndim=1, mode="c"] rows = rows_array, first = first_array
    sums_array, place_array, covariance_array = np.zeros((5, m)), np.empty((m, 2)), np.empty((m, 2, 2))
    cdef object[double, ndim=2, mode="c"] sums = sums_array, place = place_array
    cdef object[double, ndim=3, mode="c"] covariance = covariance_array
    with nogil:
        m = 0
        for t in range(most + 1):
            if slot[t] >= 0:
                rows[m], first[m] = t, slot[t]
                slot[t] = m
                m += 1
        for i in range(n):
            t = slot[body[i]]
            group[i] = t
            a = noise[i, 0, 0] + (spread[i] + least)
            d = noise[i, 1, 1] + (spread[i] + least)
            b = noise[i, 0, 1]
            determinant = a * d - b * b
            x, y = position[i, 0] - offset[i, 0], position[i, 1] - offset[i, 1]
            sums[0, t] = sums[0, t] + d / determinant
            sums[1, t] = sums[1, t] + -b / determinant
            sums[2, t] = sums[2, t] + a / determinant
            sums[3, t] = sums[3, t] + (d * x - b * y) / determinant
            sums[4, t] = sums[4, t] + (a * y - b * x) / determinant
        for t in range(m):
            determinant = sums[0, t] * sums[2, t] - sums[1, t] * sums[1, t]
            covariance[t, 0, 0] = sums[2, t] / determinant
            covariance[t, 0, 1] = covariance[t, 1, 0] = -sums[1, t] / determinant
            covariance[t, 1, 1] = sums[0, t] / determinant
            place[t, 0] = (sums[2, t] * sums[3, t] - sums[1, t] * sums[4, t]) / determinant
            place[t, 1] = (sums[0, t] * sums[4, t] - sums[1, t] * sums[3, t]) / determinant
    return rows_array, first_array, group_array, place_array, covariance_array


def note_rates(
    object[double, ndim=1, mode="strided"] noted,
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="strided"] shown,
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] measured,
    double x0,
    double y0,
    double vx0,
    double vy0,
    object[double, ndim=1, mode="strided"] share,
    object[double, ndim=1, mode="strided"] turn,
    object[double, ndim=2, mode="strided"] pivot,
):
    """Note in place how much faster than their bodies reflections come nearer."""
    cdef Py_ssize_t m = len(row), i, t
    cdef double x, y, vx, vy, nearest, difference
    with nogil:
        for i in range(m):
            t = body[i]
            x, y = shown[t, 0] + offset[i, 0], shown[t, 1] + offset[i, 1]
            vx, vy = shown[t, 2], shown[t, 3]
            if turn is not None:
                vx, vy = vx + -turn[t] * (y - pivot[t, 1]), vy + turn[t] * (x - pivot[t, 0])
            x, y = x - x0, y - y0
            nearest = larger(sqrt(x * x + y * y), 1e-3)
            difference = measured[i] - (x / nearest * (vx - vx0) + y / nearest * (vy - vy0))
            if not isfinite(difference):
                difference = 0.0
            noted[row[i]] = noted[row[i]] + share[t] * (difference - noted[row[i]])


cdef double excess(double measured, double told) noexcept nogil:
    """By how much a speed exceeds another; 0 where it was not measured."""
    cdef double difference = measured - told
    return difference if difference == difference else 0.0


cdef void sort_few(double* values, Py_ssize_t n) noexcept nogil:
    """Sort a few numbers in place."""
    cdef Py_ssize_t i, j
    cdef double value
    for i in range(1, n):
        value, j = values[i], i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j = j - 1
        values[j] = value


def apart_from_most(
    const Py_ssize_t[:] body,
    const double[:] fastest,
    const double[:, :] shown,
    const double[:, :] position,
    const double[:] range_rate,
    double x0,
    double y0,
    double vx0,
    double vy0,
    tuple projections,
    const double[:] turn,
    const double[:, :] pivot,
    Py_ssize_t fewest,
    double slowest,
    double most,
):
    """Return rows of detections that exceed the speed of their body by more or less than its median detection does.

    Only bodies of so many detections count, that have been faster than the slowest; and only what is apart by most.
    """
    cdef Py_ssize_t n = body.shape[0], k = fastest.shape[0], m = 0, f = 0, i, j, t, at, members, middle
    cdef Py_ssize_t parts = len(projections) + (range_rate is not None)
    cdef Py_ssize_t* count = <Py_ssize_t*> malloc((k + n + 1) * sizeof(Py_ssize_t))
    cdef Py_ssize_t* rows = count + k
    cdef double* speeds = <double*> malloc(((parts + 4) * n + 1) * sizeof(double))
    cdef double* speed
    cdef double* velocity = speeds + parts * n
    cdef double* ordered = velocity + 2 * n
    cdef double* apart = ordered + n
    cdef double x, y, nearest, median
    cdef const double[:, :] direction
    cdef const double[:] value
    if not count or not speeds:
        free(count)
        free(speeds)
        raise MemoryError
    try:
        for t in range(k):
            count[t] = 0
        for i in range(n):
            if body[i] >= 0:
                count[body[i]] += 1
        for i in range(n):
            t = body[i]
            if t >= 0 and count[t] >= fewest and fastest[t] > slowest:
                rows[m] = i
                velocity[2 * m], velocity[2 * m + 1] = shown[t, 2], shown[t, 3]
                if turn is not None:
                    velocity[2 * m] = velocity[2 * m] + -turn[t] * (position[i, 1] - pivot[t, 1])
                    velocity[2 * m + 1] = velocity[2 * m + 1] + turn[t] * (position[i, 0] - pivot[t, 0])
                apart[m] = 0.0
                m += 1
        if not m:
            return []
        for part in projections:
            direction, value, speed = part.direction, part.value, speeds + f * n
            for j in range(m):
                i = rows[j]
                x, y = direction[i, 0] * velocity[2 * j], direction[i, 1] * velocity[2 * j + 1]
                speed[j] = excess(value[i], x + y)
            f += 1
        if range_rate is not None:
            speed = speeds + f * n
            for j in range(m):
                i = rows[j]
                x, y = position[i, 0] - x0, position[i, 1] - y0
                nearest = larger(sqrt(x * x + y * y), 1e-3)
                x, y = x / nearest * (velocity[2 * j] - vx0), y / nearest * (velocity[2 * j + 1] - vy0)
                speed[j] = excess(range_rate[i], x + y)
            f += 1
        for t in range(k):
            if count[t] < fewest or not fastest[t] > slowest:
                continue
            for at in range(f):
                speed, members = speeds + at * n, 0
                for j in range(m):
                    if body[rows[j]] == t:
                        ordered[members] = speed[j]
                        members += 1
                sort_few(ordered, members)
                middle = members // 2
                median = ordered[middle]
                if members % 2 == 0:
                    median = (ordered[middle - 1] + ordered[middle]) / 2.0
                for j in range(m):
                    if body[rows[j]] == t:
                        apart[j] = larger(fabs(speed[j] - median), apart[j])
        return [rows[j] for j in range(m) if apart[j] > most]
    finally:
        free(count)
        free(speeds)


def learn_offsets(
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] variance,
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=3, mode="strided"] noise,
    object[double, ndim=2, mode="strided"] shown,
    object[double, ndim=2, mode="strided"] before,
    object[double, ndim=2, mode="strided"] axis,
):
    """Update in place where on their bodies reflections lie, and how uncertain that is."""
    cdef Py_ssize_t m = len(row), i, t, r
    cdef double x, y, gain
    with nogil:
        for i in range(m):
            t, r = body[i], row[i]
            x = position[i, 0] - shown[t, 0] - before[i, 0]
            y = position[i, 1] - shown[t, 1] - before[i, 1]
            gain = variance[r] / (variance[r] + 0.5 * (noise[i, 0, 0] + noise[i, 1, 1]))
            offset[r, 0] = offset[r, 0] + gain * (x * axis[t, 0] + y * axis[t, 1])
            offset[r, 1] = offset[r, 1] + gain * (y * axis[t, 0] - x * axis[t, 1])
            variance[r] = (1.0 - gain) * variance[r]


def note_strays(
    object[double, ndim=2, mode="strided"] trail,
    object[double, ndim=1, mode="strided"] walked,
    object[double, ndim=1, mode="strided"] stood,
    object[Py_ssize_t, ndim=1, mode="strided"] trail_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=3, mode="strided"] noise,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] dt,
    object[double, ndim=1, mode="strided"] keep,
    object[unsigned char, ndim=1, mode="strided"] lost,
    Py_ssize_t time_ns,
    double sensor_x,
    double sensor_y,
    double own_vx,
    double own_vy,
    double slow,
    double distance,
    double deviations,
    double memory_cubed,
    double surely,
    double jump,
    double least_jump,
    double walking,
    double running,
    double still,
    double perhaps,
    double longest,
    double nearest,
):
    """Follow in place reflections (m,) for themselves, and note how far they walk and for how long they stand."""
    cdef Py_ssize_t m = len(row), i, r
    cdef double x, y, gain, share, variance, residual, least, turns, speed, slowest, unsure
    with nogil:
        for i in range(m):
            r = row[i]
            x, y = trail[r, 0] + dt[i] * trail[r, 2], trail[r, 1] + dt[i] * trail[r, 3]
            variance = noise[i, 0, 0] + noise[i, 1, 1]
            residual = (position[i, 0] - x) * (position[i, 0] - x) + (position[i, 1] - y) * (position[i, 1] - y)
            least = larger(walking * dt[i], running * smaller(dt[i], (time_ns - last_ns[r]) * 1e-9)) + least_jump
            if not lost[i] and residual > larger(jump * variance, least * least):
                continue
            gain, share = (1.0 - keep[i]) * (1.0 - keep[i]) / dt[i], 1.0 - keep[i] * keep[i]
            trail[r, 2] = 0.0 if lost[i] else trail[r, 2] + gain * (position[i, 0] - x)
            trail[r, 3] = 0.0 if lost[i] else trail[r, 3] + gain * (position[i, 1] - y)
            trail[r, 0] = position[i, 0] if lost[i] else x + share * (position[i, 0] - x)
            trail[r, 1] = position[i, 1] if lost[i] else y + share * (position[i, 1] - y)
            trail_ns[r] = time_ns
            x, y = position[i, 0] - sensor_x, position[i, 1] - sensor_y
            turns = fabs(x * own_vy - y * own_vx) / larger(x * x + y * y, nearest)
            unsure = sqrt(variance * dt[i] / (4.0 * memory_cubed))
            slowest = larger(slow, surely * unsure) + 0.5 * length[body[i]] * turns
            speed = sqrt(trail[r, 2] * trail[r, 2] + trail[r, 3] * trail[r, 3])
            share = smaller(dt[i], longest) * speed / larger(distance, deviations * sqrt(variance))
            walked[r] = walked[r] + share if speed > slowest and speed < running else 0.0
            stood[r] = stood[r] + dt[i] if not lost[i] and speed < larger(still, perhaps * unsure) else 0.0


def drive_on(
    object[double, ndim=1, mode="strided"] stood,
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=1, mode="strided"] range_rate,
    object[double, ndim=1, mode="strided"] rate_variance,
    tuple projections,
    double sensor_x,
    double sensor_y,
    double own_vx,
    double own_vy,
    double slow,
    double surely,
    double nearest,
):
    """Let in place reflections (m,) not have stood of which a component of the velocity, or a range rate, tells more."""
    cdef Py_ssize_t m = len(row), i
    cdef double x, y, distance
    cdef const double[:] value, variance
    for part in projections:
        value, variance = part.value, part.variance
        for i in range(m):
            if fabs(value[i]) > slow + surely * sqrt(variance[i]):
                stood[row[i]] = 0.0
    if range_rate is None or rate_variance is None:
        return
    for i in range(m):
        if stood[row[i]] == 0.0:
            continue
        x, y = position[i, 0] - sensor_x, position[i, 1] - sensor_y
        distance = larger(sqrt(x * x + y * y), nearest)
        x, y = x / distance, y / distance
        if fabs(range_rate[i] + (x * own_vx + y * own_vy)) > slow + surely * sqrt(rate_variance[i]):
            stood[row[i]] = 0.0


cdef inline bint crosses(
    object[double, ndim=2, mode="strided"] axis,
    Py_ssize_t body,
    object[double, ndim=2, mode="strided"] trail,
    Py_ssize_t i,
) noexcept:
    """Return whether a reflection moves across the axis of its body rather than along it."""
    cdef double c = axis[body, 0], s = axis[body, 1], vx = trail[i, 2], vy = trail[i, 3]
    return fabs(vy * c - vx * s) > fabs(vx * c + vy * s)


def strays(
    object[double, ndim=1, mode="strided"] walked,
    object[double, ndim=1, mode="strided"] stood,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] leader,
    object[double, ndim=1, mode="strided"] body_fastest,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=2, mode="strided"] trail,
    object[double, ndim=2, mode="strided"] mean,
    double slow,
    double still,
    double fastest,
    double far,
    Py_ssize_t since_ns,
    Py_ssize_t time_ns,
):
    """Return the reflections detected now that walk while the body or the one that leads it stands, or that stand while
    that walks; None: there are none."""
    cdef Py_ssize_t n = len(body), i, t, lead
    cdef bint rests, vehicle
    found = []
    for i in range(n):
        t = body[i]
        lead = leader[t]
        if last_ns[i] != time_ns or last_ns[lead] < since_ns:
            continue
        vehicle = body_fastest[t] >= fastest
        if walked[lead] >= 1.0 and (not vehicle or walked[lead] >= far or crosses(axis, t, trail, lead)):
            if stood[i] >= still:
                found.append(i)
        elif walked[i] >= 1.0 and (not vehicle or walked[i] >= far or crosses(axis, t, trail, i)):
            rests = mean[t, 2] * mean[t, 2] + mean[t, 3] * mean[t, 3] < slow and stood[lead] > 0.0
            if rests and not vehicle or stood[lead] >= still:
                found.append(i)
    return np.array(found, np.intp) if found else None


def factors_of_scans(
    object[double, ndim=1, mode="strided"] interval,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    double cycle_time,
    object[double, ndim=1, mode="strided"] by_scans,
):
    """Return of bodies (m,) the factor by the number of scans in the interval since each one's detection before."""
    cdef Py_ssize_t m = len(body), i
    cdef double last = len(by_scans) - 1
    out_array = np.empty(m)
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for i in range(m):
            out[i] = by_scans[<Py_ssize_t>smaller(rint(interval[body[i]] / cycle_time), last)]
    return out_array


def note_innovations(
    object[double, ndim=2, mode="strided"] innovation,
    object[Py_ssize_t, ndim=1, mode="strided"] row,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] seen_by,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] leader,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[double, ndim=2, mode="strided"] shown,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=3, mode="strided"] noise,
    Py_ssize_t sensor,
    Py_ssize_t since_ns,
    Py_ssize_t born_ns,
    double most,
    double unused,
):
    """Note innovations of leading reflections in place; return the sums of products with those before, and squares."""
    cdef Py_ssize_t m = len(row), i, t, r
    cdef double x, y, deviation, square, before, products = 0.0, squares = 0.0
    with nogil:
        for i in range(m):
            r = row[i]
            t = body[r]
            if not (confirmed[t] and first_ns[t] < born_ns and leader[t] == r):
                innovation[r, 0] = innovation[r, 1] = unused
                continue
            deviation = sqrt(0.5 * (noise[i, 0, 0] + noise[i, 1, 1]))
            x, y = (position[i, 0] - shown[t, 0]) / deviation, (position[i, 1] - shown[t, 1]) / deviation
            square = x * x + y * y
            before = innovation[r, 0] * innovation[r, 0] + innovation[r, 1] * innovation[r, 1]
            if last_ns[r] >= since_ns and seen_by[r] == sensor and square < most and before < most:
                products = products + (x * innovation[r, 0] + y * innovation[r, 1])
                squares = squares + 0.5 * (square + before)
            innovation[r, 0], innovation[r, 1] = x, y
    return products, squares


def note_sizes(
    object[double, ndim=1, mode="strided"] alone,
    object[double, ndim=1, mode="strided"] fastest,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] width_variance,
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    const double[:, :] mean,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] rows,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=1, mode="strided"] origin,
    object[double, ndim=1, mode="strided"] own,
    object[double, ndim=1, mode="strided"] interval,
    object[double, ndim=1, mode="strided"] in_sight,
    Py_ssize_t time_ns,
    double near,
    double alone_time,
    double faster_share,
    double crossing_share,
    double crossing,
    double wholly,
    double never,
    double age,
    double told,
    double moved,
    double walking,
    double riding,
    double pace,
    double pace_time,
    walker,
    rider,
):
    """Note in place how long bodies have shown one reflection close by, how fast they were, and which are small so."""
    cdef Py_ssize_t m = len(body), k = len(alone), i, t
    cdef double walker_length = walker[0], walker_width = walker[1]
    cdef double rider_length = rider[0], rider_width = rider[1], speed, faster, counts, x, y, across, along
    seen_array = np.zeros((3, k), np.intp)
    cdef object[Py_ssize_t, ndim=2, mode="c"] seen = seen_array
    with nogil:
        for i in range(m):
            t = body[i]
            x, y = position[rows[i], 0] - origin[0], position[rows[i], 1] - origin[1]
            across, along = mean[t, 3] * x - mean[t, 2] * y, mean[t, 2] * x + mean[t, 3] * y
            seen[0, t] += 1
            if sqrt(x * x + y * y) < near:
                seen[1, t] = 1
            if fabs(across) > crossing * fabs(along):
                across, along = mean[t, 3] * own[0] - mean[t, 2] * own[1], mean[t, 2] * own[0] + mean[t, 3] * own[1]
                if fabs(across) >= crossing * fabs(along):
                    seen[2, t] = 1
        for t in range(k):
            speed = velocity_of(mean, t)
            if seen[0, t] > 1:
                alone[t] = never
            elif seen[0, t] == 1 and seen[1, t]:
                counts = 1.0 if speed < walking else faster_share
                if seen[2, t]:
                    counts = crossing_share
                if speed > moved and in_sight[t] >= wholly:
                    alone[t] = alone[t] + interval[t] * counts / alone_time
            fastest[t] = larger(fastest[t], speed if (time_ns - first_ns[t]) * 1e-9 > age else 0.0)
            if alone[t] > 1.0 and smaller(length_variance[t], width_variance[t]) > told and fastest[t] > moved:
                if seen[0, t] > 0 and speed > moved and fastest[t] < riding:
                    faster = larger(fastest[t] - larger(speed, pace), 0.0)
                    fastest[t] -= smaller(interval[t] / pace_time, 1.0) * faster
                if fastest[t] < walking:
                    length[t], width[t] = walker_length, walker_width
                elif fastest[t] < riding:
                    length[t], width[t] = rider_length, rider_width


def grow_boxes(
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] extent,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] width_variance,
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[double, ndim=1, mode="strided"] passed,
    object[double, ndim=1, mode="strided"] share,
    object[double, ndim=2, mode="strided"] mean,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] seen_by,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[double, ndim=2, mode="strided"] offset,
    Py_ssize_t time_ns,
    Py_ssize_t sensor,
    Py_ssize_t since_ns,
    double shrinkage_time,
    double car_length,
    double axis_speed,
    double age,
    double margin,
    double truck_length,
    double told,
    double truck_width,
    double enough,
    double car_width,
):
    """Let boxes in place grow along them, by a share each, to the reflections of a scan and those of other sensors since
    a time; and shrink to a car's length by the time that has passed."""
    cdef Py_ssize_t n = len(body), k = len(length), i, t
    cdef double shown
    cdef bint known
    ends_array = np.empty((2, k))
    cdef object[double, ndim=2, mode="c"] ends = ends_array
    with nogil:
        for t in range(k):
            if length_variance[t] > 1.0:
                length[t] = length[t] - passed[t] / shrinkage_time * larger(length[t] - car_length, 0.0)
            ends[0, t], ends[1, t] = INFINITY, -INFINITY
        if n != k:
            for i in range(n):
                if last_ns[i] == time_ns or last_ns[i] >= since_ns and seen_by[i] != sensor:
                    t = body[i]
                    ends[0, t] = smaller(ends[0, t], offset[i, 0])
                    ends[1, t] = larger(ends[1, t], offset[i, 0])
            for t in range(k):
                known = mean[t, 2] * mean[t, 2] + mean[t, 3] * mean[t, 3] > axis_speed * axis_speed
                known = known and (time_ns - first_ns[t]) * 1e-9 > age
                shown = ends[1, t] - ends[0, t] + margin if known and ends[1, t] > ends[0, t] else 0.0
                length[t] = length[t] + share[t] * larger(shown - length[t], 0.0)
                extent[t] = extent[t] + share[t] * larger(shown - extent[t], 0.0)
                if width_variance[t] > told:
                    if length[t] > truck_length:
                        width[t] = truck_width
                    elif smaller(length[t], extent[t]) > enough:
                        width[t] = larger(width[t], car_width)


def sight_lines(
    object[double, ndim=2, mode="strided"] centre,
    object[double, ndim=2, mode="strided"] reference,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    double mount_x,
    double mount_y,
    double least,
    double point,
):
    """Return of boxes (5, k) where their centres are from the mount, how far, how far their reference points are, and
    how wide they are across the line of sight; what has no size or axis is as wide as a point."""
    cdef Py_ssize_t k = len(length), t
    cdef double x, y, near, sine, cosine
    out_array = np.empty((5, k))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            x, y = centre[t, 0] - mount_x, centre[t, 1] - mount_y
            out[0, t], out[1, t] = x, y
            out[2, t] = sqrt(x * x + y * y)
            near = larger(out[2, t], least)
            sine = (axis[t, 1] * x - axis[t, 0] * y) / near
            cosine = (axis[t, 0] * x + axis[t, 1] * y) / near
            x, y = reference[t, 0] - mount_x, reference[t, 1] - mount_y
            out[3, t] = sqrt(x * x + y * y)
            out[4, t] = point
            if length[t] > 0.0 and width[t] > 0.0 and isfinite(axis[t, 0]) and isfinite(axis[t, 1]):
                out[4, t] = fabs(sine) * length[t] + fabs(cosine) * width[t]
    return out_array


def shares_in_sight(
    object[double, ndim=1, mode="strided"] bearing,
    object[double, ndim=1, mode="strided"] angle,
    object[double, ndim=1, mode="strided"] away,
    object[double, ndim=1, mode="strided"] distance,
    double yaw,
    double opening,
    double least_range,
    double most_range,
    bint behind,
    double margin,
    double range_margin,
    double half_turn,
):
    """Return the share of each box in sight (k,); others hide what their centres are nearer than.

    Azimuths come again after a turn, where the sensor sees so far behind.
    """
    cdef Py_ssize_t k = len(bearing), t, other
    cdef int times, more = 2 if behind else 1
    cdef double total, shared, round, half, azimuth, inside, turn = 2.0 * half_turn
    out_array, low_array, high_array = np.empty(k), np.empty(k), np.empty(k)
    cdef object[double, ndim=1, mode="c"] out = out_array, low = low_array, high = high_array
    cdef object[double, ndim=2, mode="c"] first = np.empty((more, k)), last = np.empty((more, k))
    with nogil:
        for t in range(k):
            azimuth = fmod(bearing[t] - yaw + half_turn, turn)
            if azimuth < 0.0:
                azimuth = azimuth + turn
            azimuth = azimuth - half_turn
            half = angle[t] + margin
            low[t], high[t] = azimuth - half, azimuth + half
            first[0, t], last[0, t] = low[t] + margin + 0.0, high[t] - margin + 0.0
            if behind:
                round = -turn if low[t] + high[t] > 0.0 else turn
                first[1, t], last[1, t] = low[t] + margin + round, high[t] - margin + round
        for t in range(k):
            total = 0.0
            for times in range(more):
                for other in range(k):
                    if first[times, other] >= high[t] or last[times, other] <= low[t]:
                        continue  # most are beside one another: they share nothing
                    if away[other] < distance[t] and (times or other != t):
                        shared = smaller(high[t], last[times, other]) - larger(low[t], first[times, other])
                        total = total + larger(shared, 0.0)
            out[t] = 1.0 - total / (high[t] - low[t])
            if opening < half_turn:
                half = angle[t] + margin
                inside = smaller(high[t], opening) - larger(low[t], -opening)
                out[t] = out[t] - (1.0 - larger(inside, 0.0) / smaller(2.0 * half, 2.0 * opening))
            inside = smaller(distance[t] - least_range, most_range - distance[t]) / range_margin + 0.5
            out[t] = smaller(larger(out[t], 0.0), 1.0) * smaller(larger(inside, 0.0), 1.0)
    return out_array


def boxes_in_vehicle_axes(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=2, mode="strided"] axis,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] fastest,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[double, ndim=1, mode="strided"] standing,
    double east,
    double north,
    double c,
    double s,
    double surely,
    double moved,
    double post,
):
    """Return of bodies in vehicle axes reference points, centres and axes (3, k, 2), and lengths and widths as far as they
    hide others (2, k)."""
    cdef Py_ssize_t k = len(length), t
    cdef double x, y
    points_array, size_array = np.empty((3, k, 2)), np.empty((2, k))
    cdef object[double, ndim=3, mode="c"] points = points_array
    cdef object[double, ndim=2, mode="c"] size = size_array
    with nogil:
        for t in range(k):
            x, y = mean[t, 0] - east, mean[t, 1] - north
            points[0, t, 0], points[0, t, 1] = x * c + y * s, y * c - x * s
            x, y = facing[t, 0], facing[t, 1]
            points[1, t, 0], points[1, t, 1] = points[0, t, 0] - (x * c + y * s), points[0, t, 1] - (y * c - x * s)
            x, y = axis[t, 0], axis[t, 1]
            points[2, t, 0], points[2, t, 1] = x * c + y * s, y * c - x * s
            if not confirmed[t] or (standing[t] > surely and length_variance[t] > 1.0 and fastest[t] < moved):
                size[0, t], size[1, t] = post, post
            else:
                size[0, t], size[1, t] = length[t], width[t]
    return points_array, size_array


def detection_probabilities(
    object[double, ndim=1, mode="strided"] share,
    object[double, ndim=1, mode="strided"] distance,
    object[unsigned char, ndim=1, mode="strided"] missed,
    object[double, ndim=2, mode="strided"] detected,
    object[double, ndim=2, mode="strided"] expected,
    object[double, ndim=2, mode="strided"] prior,
    double weight,
    double part,
    double least,
    double most,
):
    """Return with which probability bodies are detected (k,): linear between the middles of the parts of the range, of
    which is given how often what was detected and missed before has been detected and expected (2, R), beside what is
    known of it first (2, 1), with a weight."""
    cdef Py_ssize_t k = len(share), last = detected.shape[1] - 1, t, lower
    cdef int row
    cdef double at, nearer, farther
    out_array = np.empty(k)
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            at = within(distance[t] / part - 0.5, 0.0, <double>last)
            lower = min(<Py_ssize_t>at, last - 1)
            row = 1 if missed[t] else 0
            nearer = (detected[row, lower] + prior[row, 0]) / (expected[row, lower] + weight)
            farther = (detected[row, lower + 1] + prior[row, 0]) / (expected[row, lower + 1] + weight)
            at = nearer + (at - lower) * (farther - nearer)
            out[t] = smaller(larger(share[t] * at, least), most)
    return out_array


def likelihood_ratios(
    object[double, ndim=3, mode="strided"] spread,
    object[double, ndim=1, mode="strided"] variance,
    object[double, ndim=3, mode="strided"] noise,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] reflection,
    object[double, ndim=1, mode="strided"] fit,
    double scale,
):
    """Return which bodies are detected (k,), and the likelihoods of their detections over the density of clutter, 0
    without one; of several detections the last one's."""
    cdef Py_ssize_t m = len(reflection), k = len(spread), i, t
    cdef double a, b, d, more
    seen_array, out_array = np.zeros(k, np.bool_), np.zeros(k)
    cdef object[unsigned char, ndim=1, mode="c"] seen = seen_array
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for i in range(m):
            if reflection[i] < 0:
                continue
            t, more = body[i], variance[reflection[i]]
            a = spread[t, 0, 0] + more + noise[i, 0, 0]
            b = spread[t, 0, 1] + noise[i, 0, 1]
            d = spread[t, 1, 1] + more + noise[i, 1, 1]
            seen[t] = True
            out[t] = fit[i] / (scale * sqrt(larger(a * d - b * b, 1e-12)))
    return seen_array, out_array


cdef void add_places(
    double[:, :, ::1] covariance,
    double[:, ::1] told,
    const double[:] length,
    const double[:] alone,
    const double[:, :] own,
    double time,
    double close,
    double small,
    double place,
    double large,
    double anywhere,
) noexcept nogil:
    """Add what is unknown of where on bodies reflections lie, and of our own velocity; tell the deviations."""
    cdef Py_ssize_t t
    cdef double x, y, norm, side, ax, ay, variance, xx, xy, yy, lx, ly, speed
    for t in range(length.shape[0]):
        x, y = told[0, t], told[1, t]
        norm = larger(sqrt(x * x + y * y), close)
        x, y = x / norm, y / norm
        ax, ay = told[11, t], told[12, t]
        variance = large if alone[t] < 0.0 else (small if alone[t] > 1.0 else place)
        variance = variance * variance
        side = anywhere * (length[t] * (ax * y - ay * x))
        ax, ay = side * ax, side * ay
        xx, xy, yy = variance + ax * ax, ax * ay, variance + ay * ay
        lx, ly = -y, x
        speed = lx * xx * lx + lx * xy * ly + ly * xy * lx + ly * yy * ly
        speed = speed / (time * time)
        covariance[t, 0, 0] = covariance[t, 0, 0] + xx
        covariance[t, 0, 1] = covariance[t, 0, 1] + xy
        covariance[t, 1, 0] = covariance[t, 1, 0] + xy
        covariance[t, 1, 1] = covariance[t, 1, 1] + yy
        covariance[t, 2, 2] = covariance[t, 2, 2] + (own[0, 0] + speed * lx * lx)
        covariance[t, 2, 3] = covariance[t, 2, 3] + (own[0, 1] + speed * lx * ly)
        covariance[t, 3, 2] = covariance[t, 3, 2] + (own[1, 0] + speed * ly * lx)
        covariance[t, 3, 3] = covariance[t, 3, 3] + (own[1, 1] + speed * ly * ly)
        told[6, t] = sqrt(larger(covariance[t, 0, 0], 0.0))
        told[7, t] = sqrt(larger(covariance[t, 1, 1], 0.0))
        told[8, t] = sqrt(larger(covariance[t, 2, 2], 0.0))
        told[9, t] = sqrt(larger(covariance[t, 3, 3], 0.0))


def states_of_reflections(
    const double[:, ::1] shown,
    const double[:, :, ::1] spread,
    const Py_ssize_t[:] body,
    const double[:, :] offset,
    const double[:] variance,
    const double[:, :] axis,
    const double[:] turn,
    const double[:, :] pivot,
):
    """Return where reflections are expected and how they move, (n, 4) and (n, 4, 4)."""
    cdef Py_ssize_t n = body.shape[0], i, t
    mean_array, covariance_array = np.empty((n, 4)), np.empty((n, 4, 4))
    cdef double[:, ::1] mean = mean_array
    cdef double[:, :, ::1] covariance = covariance_array
    with nogil:
        for i in range(n):
            t = body[i]
            memcpy(&mean[i, 0], &shown[t, 0], 4 * sizeof(double))
            memcpy(&covariance[i, 0, 0], &spread[t, 0, 0], 16 * sizeof(double))
            mean[i, 0] = mean[i, 0] + (offset[i, 0] * axis[t, 0] - offset[i, 1] * axis[t, 1])
            mean[i, 1] = mean[i, 1] + (offset[i, 1] * axis[t, 0] + offset[i, 0] * axis[t, 1])
            if turn is not None:
                mean[i, 2] = mean[i, 2] + -turn[t] * (mean[i, 1] - pivot[t, 1])
                mean[i, 3] = mean[i, 3] + turn[t] * (mean[i, 0] - pivot[t, 0])
            covariance[i, 0, 0] = covariance[i, 0, 0] + variance[i]
            covariance[i, 1, 1] = covariance[i, 1, 1] + variance[i]
    return mean_array, covariance_array


def turning_of_bodies(
    object[double, ndim=2, mode="c"] probability,
    object[double, ndim=3, mode="c"] mean,
    object[double, ndim=4, mode="c"] covariance,
    object[double, ndim=2, mode="strided"] overall,
    object[double, ndim=2, mode="strided"] facing,
    object[double, ndim=1, mode="strided"] length,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] extent,
    object[double, ndim=1, mode="strided"] alone,
    object[unsigned char, ndim=1, mode="strided"] directed,
    double told_length,
    double small,
    double enough,
):
    """Return turn rates and their variances over all modes of bodies that are no points, 0 of others, (k,), and the
    points whose velocity is told (k, 2); None: there are only points."""
    cdef Py_ssize_t k = len(length), modes = mean.shape[1], i, t
    cdef bint sized, some = False
    cdef double apart
    for t in range(k):
        sized = has_size(length[t], length_variance[t], extent[t], told_length, small, enough)
        if (sized or alone[t] < 0.0) and directed[t] and length[t] >= small:
            some = True
            break
    if not some:
        return None
    rate_array, variance_array, pivot_array = np.zeros(k), np.zeros(k), np.empty((k, 2))
    cdef object[double, ndim=1, mode="c"] rate = rate_array, variance = variance_array
    cdef object[double, ndim=2, mode="c"] pivot = pivot_array
    with nogil:
        for t in range(k):
            sized = has_size(length[t], length_variance[t], extent[t], told_length, small, enough)
            pivot[t, 0], pivot[t, 1] = overall[t, 0], overall[t, 1]
            if sized:
                pivot[t, 0], pivot[t, 1] = overall[t, 0] - facing[t, 0], overall[t, 1] - facing[t, 1]
            if not ((sized or alone[t] < 0.0) and directed[t] and length[t] >= small):
                continue
            rate[t] = probability[0, t] * mean[4, 0, t]
            for i in range(1, modes):
                rate[t] = rate[t] + probability[i, t] * mean[4, i, t]
            for i in range(modes):
                apart = mean[4, i, t] - rate[t]
                apart = probability[i, t] * (covariance[4, 4, i, t] + apart * apart)
                variance[t] = variance[t] + apart if i else apart
    return rate_array, variance_array, pivot_array


cdef bint swings(const double[:, :] overall, const double[:, :] pivot) noexcept nogil:
    """Return whether some body turns about another point than the one that is told."""
    cdef Py_ssize_t t
    for t in range(overall.shape[0]):
        if overall[t, 0] - pivot[t, 0] != 0.0 or overall[t, 1] - pivot[t, 1] != 0.0:
            return True
    return False


cdef void swing(
    const double[:, :] overall,
    const double[:] standing,
    const double[:] rate,
    const double[:] variance,
    const double[:, :] pivot,
    double[:, ::1] more,
    double[:, ::1] unknown,
) noexcept nogil:
    cdef Py_ssize_t t
    cdef double moves, deviation, ahead, aside
    for t in range(overall.shape[0]):
        ahead, aside = overall[t, 0] - pivot[t, 0], overall[t, 1] - pivot[t, 1]
        moves, deviation = 1.0 - standing[t], sqrt(variance[t])
        more[t, 0], more[t, 1] = moves * (rate[t] * -aside), moves * (rate[t] * ahead)
        unknown[t, 0], unknown[t, 1] = moves * (deviation * -aside), moves * (deviation * ahead)


def swing_of_bodies(
    const double[:, :] overall,
    const double[:] standing,
    const double[:] rate,
    const double[:] variance,
    const double[:, :] pivot,
):
    """Return what turning adds to the velocities of bodies, as far as they do not stand, and a standard deviation of it,
    a vector, (k, 2) each; None: all turn about the points that are told."""
    cdef Py_ssize_t k = overall.shape[0]
    if not swings(overall, pivot):
        return None
    more_array, unknown_array = np.empty((k, 2)), np.empty((k, 2))
    cdef double[:, ::1] more = more_array, unknown = unknown_array
    with nogil:
        swing(overall, standing, rate, variance, pivot, more, unknown)
    return more_array, unknown_array


def weigh_existence(
    object[double, ndim=1, mode="strided"] existence,
    object[double, ndim=1, mode="strided"] in_sight,
    object[double, ndim=1, mode="strided"] unseen,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[unsigned char, ndim=1, mode="strided"] seen,
    object[unsigned char, ndim=1, mode="strided"] expected,
    object[double, ndim=1, mode="strided"] share,
    object[double, ndim=1, mode="strided"] detection,
    object[double, ndim=1, mode="strided"] likelihood,
    double limit,
    double careful,
    double most,
    double first,
    double least,
    double largest,
):
    """Weigh in place what a scan says of whether bodies exist, by a limited factor, and note what it could see."""
    cdef Py_ssize_t k = len(existence), t
    cdef double ratio, probability, prior, present, odds, after
    with nogil:
        for t in range(k):
            if not (seen[t] or expected[t]):
                continue
            if seen[t] and confirmed[t] and existence[t] < first:
                existence[t] = first
            ratio = within(likelihood[t], 0.0, largest)
            probability = within(detection[t], 0.0, 1.0)
            prior = within(existence[t], least, 1.0 - least)
            present = (1.0 - probability + probability * ratio) * prior
            after = within(present / (present + 1.0 - prior), least, 1.0 - least)
            if seen[t]:
                after = larger(after, existence[t])
            odds = existence[t] / (1.0 - existence[t])
            after = after / (1.0 - after)
            after = smaller(larger(after, odds / (limit if confirmed[t] else careful)), odds * most)
            existence[t] = within(after / (1.0 + after), least, 1.0 - least)
            in_sight[t] = 1.0 if seen[t] else share[t]
            if seen[t]:
                unseen[t] = 0.0


cdef inline double within(double value, double least, double most) noexcept nogil:
    """np.fmin(np.fmax(value, least), most): what is no number becomes the least."""
    if not value > least:
        return least
    return value if value < most else most


def opportunities(
    object[double, ndim=1, mode="strided"] share,
    object[double, ndim=1, mode="strided"] distance,
    object[unsigned char, ndim=1, mode="strided"] seen,
    object[unsigned char, ndim=1, mode="strided"] missed,
    object[unsigned char, ndim=1, mode="strided"] counts,
    double clear,
    double part,
    int parts,
):
    """Return how often what counts was clearly in sight, and how often of it seen, by whether missed before and range."""
    cdef Py_ssize_t k = len(share), t
    cdef double rest, at, whole
    cdef int row
    out_array = np.zeros((2, 2, parts))
    cdef object[double, ndim=3, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            if counts[t] and share[t] > clear and isfinite(distance[t]):
                rest = fmod(distance[t], part)
                at = (distance[t] - rest) / part
                whole = <double>(<Py_ssize_t>at)
                if at - whole > 0.5:
                    whole = whole + 1.0
                row = 1 if missed[t] else 0
                at = whole if whole < parts - 1 else parts - 1
                out[0, row, <Py_ssize_t>at] += 1.0
                out[1, row, <Py_ssize_t>at] += seen[t]
    return out_array


def learn_rates(
    double[:, :] expected,
    object[double, ndim=2, mode="strided"] detected,
    object[double, ndim=3, mode="strided"] counts,
    object[double, ndim=2, mode="strided"] fading,
    double most,
):
    """Let in place how often what was detected and missed before was expected and detected (2, R) fade, and count for how
    often it was now (2, 2, R), at most as often."""
    cdef Py_ssize_t row, part
    cdef double count, share
    for row in range(2):
        for part in range(expected.shape[1]):
            count = counts[0, row, part]
            share = smaller(1.0, most / larger(count, 1.0))
            expected[row, part] = expected[row, part] * fading[row, part] + smaller(count, most)
            detected[row, part] = detected[row, part] * fading[row, part] + counts[1, row, part] * share


def report_bodies(
    const double[:, :] mean,
    const double[:, :, :] covariance,
    const double[:] standing,
    const double[:] turn,
    const double[:] turn_variance,
    const double[:, :] pivot,
    const double[:, :] axis,
    object[double, ndim=2, mode="strided"] facing,
    const double[:] length,
    object[double, ndim=1, mode="strided"] width,
    object[double, ndim=1, mode="strided"] length_variance,
    object[double, ndim=1, mode="strided"] extent,
    const double[:] alone,
    object[double, ndim=1, mode="strided"] fastest,
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    const double[:, :] own,
    double east,
    double north,
    double c,
    double s,
    Py_ssize_t time_ns,
    Py_ssize_t slack_ns,
    double wander_time,
    double slow_course,
    double close,
    double small_place,
    double place,
    double large_place,
    double anywhere,
    double surely,
    double settled,
    double slow,
    double told_length,
    double small,
    double enough,
    double narrow,
    double truck_length,
    double walking,
):
    """Return what is told of k bodies in the axes of a vehicle at (east, north) and in the local frame.

    Rows of the first (22, k): x, y, vx, vy, ax, ay, the deviations of the first four, yaw rate, the axis, a vector,
    length, width, x and y of the centre, age, east, north and velocity there, NaN where unknown. State and class (2, k);
    covariance of [x, y, vx, vy] (k, 4, 4).
    """
    cdef Py_ssize_t k = mean.shape[0], t, i
    cdef double first, second, speed
    cdef double gone[2]
    cdef bint is_told, sized, turns = turn is not None and swings(mean, pivot)
    numbers_array, codes_array = np.empty((22, k)), np.zeros((2, k), np.int8)
    turned_array, moving_array = np.empty((k, 4, 4)), np.empty((k, 6))
    cdef double[:, ::1] numbers = numbers_array, moving = moving_array
    cdef signed char[:, ::1] codes = codes_array
    cdef double[:, :, ::1] turned = turned_array
    cdef double[:, ::1] more, unknown
    cdef const double[:] forward = np.ones(k)
    if turns:
        more, unknown = np.empty((k, 2)), np.empty((k, 2))
    with nogil:
        move_bodies(mean, slow_course, moving)
        if turns:
            swing(mean, standing, turn, turn_variance, pivot, more, unknown)
            for t in range(k):
                moving[t, 2], moving[t, 3] = moving[t, 2] + more[t, 0], moving[t, 3] + more[t, 1]
        turn_into_axes(moving, covariance, axis, forward, east, north, c, s, INFINITY, numbers, turned)
        if turns:
            for t in range(k):
                first, second = unknown[t, 0], unknown[t, 1]
                gone[0], gone[1] = first * c + second * s, second * c - first * s
                for i in range(2):
                    turned[t, 2 + i, 2] = turned[t, 2 + i, 2] + gone[i] * gone[0]
                    turned[t, 2 + i, 3] = turned[t, 2 + i, 3] + gone[i] * gone[1]
        add_places(
            turned, numbers, length, alone, own, wander_time, close, small_place, place, large_place, anywhere
        )
        for t in range(k):
            speed = sqrt(numbers[2, t] * numbers[2, t] + numbers[3, t] * numbers[3, t])
            numbers[10, t] = mean[t, 4] if speed > slow else 0.0
            is_told = length_variance[t] < told_length or length[t] < small
            sized = is_told or extent[t] > enough
            numbers[13, t] = length[t] if sized else NAN
            numbers[14, t] = width[t] if sized else NAN
            numbers[15, t] = numbers[0, t] - (facing[t, 0] * c + facing[t, 1] * s if sized else 0.0)
            numbers[16, t] = numbers[1, t] - (facing[t, 1] * c - facing[t, 0] * s if sized else 0.0)
            numbers[17, t] = (time_ns - first_ns[t] if time_ns > first_ns[t] else 0) * 1e-9
            if confirmed[t]:
                codes[0, t] = 2 if time_ns - last_ns[t] > slack_ns else 1
            if is_told and width[t] >= narrow:
                codes[1, t] = 1
            if length[t] > truck_length:
                codes[1, t] = 2
            if is_told and width[t] < narrow:
                if speed > walking:
                    codes[1, t] = 3
                elif speed <= walking and length[t] < narrow:
                    codes[1, t] = 4
            if standing[t] > surely or ((time_ns - first_ns[t]) * 1e-9 > settled and fastest[t] < slow):
                codes[1, t] = 5
            for i in range(4):
                numbers[18 + i, t] = moving[t, i]
    return numbers_array, codes_array, turned_array


def fit_reflections(
    object[Py_ssize_t, ndim=1, mode="strided"] rows,
    object[unsigned char, ndim=1, mode="strided"] new,
    object[unsigned char, ndim=1, mode="strided"] vague,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="c"] shown,
    object[double, ndim=3, mode="c"] spread,
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=1, mode="strided"] variance,
    object[double, ndim=2, mode="strided"] axis,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[double, ndim=2, mode="strided"] position,
    object[double, ndim=3, mode="strided"] noise,
    object[double, ndim=1, mode="strided"] rate,
    object[double, ndim=1, mode="strided"] rate_variance,
    double x0,
    double y0,
    double vx0,
    double vy0,
    double confirmed_gate,
    double gate,
    object[double, ndim=1, mode="strided"] turn,
    object[double, ndim=2, mode="strided"] pivot,
):
    """Return which reflection each detection fits of those that its id stands for (m,), −1: none; the NIS, NaN where it
    fits none; and how many do not fit."""
    cdef Py_ssize_t m = len(rows), i, r, t, jumps = 0
    cdef int a, b
    cdef double x, y, vx, vy, distance, nearest, far, predicted, fits
    cdef double state[4]
    cdef double p[4][4]
    cdef double h[4]
    found_array, nis_array = np.empty(m, np.intp), np.empty(m)
    cdef object[Py_ssize_t, ndim=1, mode="c"] found = found_array
    cdef object[double, ndim=1, mode="c"] nis = nis_array
    with nogil:
        for i in range(m):
            r, found[i], nis[i] = rows[i], -1, NAN
            if r < 0 or new[i] or vague[body[r]]:
                continue
            t = body[r]
            for a in range(4):
                state[a] = shown[t, a]
                for b in range(4):
                    p[a][b] = spread[t, a, b]
            state[0] = state[0] + (offset[r, 0] * axis[t, 0] - offset[r, 1] * axis[t, 1])
            state[1] = state[1] + (offset[r, 1] * axis[t, 0] + offset[r, 0] * axis[t, 1])
            if turn is not None:
                state[2] = state[2] + -turn[t] * (state[1] - pivot[t, 1])
                state[3] = state[3] + turn[t] * (state[0] - pivot[t, 0])
            p[0][0] = p[0][0] + variance[r]
            p[1][1] = p[1][1] + variance[r]
            x, y, vx, vy = state[0] - x0, state[1] - y0, state[2] - vx0, state[3] - vy0
            distance = sqrt(x * x + y * y)
            nearest, far = larger(distance, 1e-3), larger(distance, 1.0)
            x, y = x / nearest, y / nearest
            predicted = x * vx + y * vy
            h[0], h[1], h[2], h[3] = (vx - predicted * x) / far, (vy - predicted * y) / far, x, y
            fits = nis_of_pair(
                state, p, position[i, 0], position[i, 1], noise[i, 0, 0], noise[i, 0, 1], noise[i, 1, 1],
                predicted, h, rate[i], rate_variance[i],
            )
            if fits <= (confirmed_gate if confirmed[t] else gate):
                found[i], nis[i] = r, fits
            else:
                jumps += 1
    return found_array, nis_array, jumps


def longer_ago(object[Py_ssize_t, ndim=1, mode="strided"] last_ns, Py_ssize_t time_ns, double longest):
    """Return of what the latest detection (n,) is longer ago than a time, s; None: of nothing."""
    cdef Py_ssize_t n = len(last_ns), i
    cdef bint some = False
    for i in range(n):
        some = some or (time_ns - last_ns[i]) * 1e-9 > longest
    if not some:
        return None
    out_array = np.empty(n, np.bool_)
    cdef object[unsigned char, ndim=1, mode="c"] out = out_array
    for i in range(n):
        out[i] = (time_ns - last_ns[i]) * 1e-9 > longest
    return out_array


def bodies_to_forget(
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[double, ndim=3, mode="strided"] covariance,
    Py_ssize_t time_ns,
    double coast,
    double longest,
    double uncertainty,
):
    """Return which bodies (k,) that were not detected for a time, s, are not remembered any longer; None: there is none.

    What is confirmed is remembered for as long as it was tracked, not for longer than the longest time, while its place
    is known.
    """
    cdef Py_ssize_t k = len(last_ns), t, count = 0
    cdef double away, tracked
    out_array = np.zeros(k, np.bool_)
    cdef object[unsigned char, ndim=1, mode="c"] out = out_array
    for t in range(k):
        away = (time_ns - last_ns[t]) * 1e-9
        if away > coast:
            tracked = (last_ns[t] - first_ns[t]) * 1e-9
            if (
                not confirmed[t]
                or away > (longest if longest < tracked else tracked)
                or sqrt(covariance[t, 0, 0] + covariance[t, 1, 1]) > uncertainty
            ):
                out[t] = True
                count += 1
    return out_array if count else None


def bodies_to_confirm(
    const double[:] existence,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    Py_ssize_t time_ns,
    double sure,
):
    """Return rows of the bodies detected at a time that exist surely and are not confirmed."""
    cdef Py_ssize_t t
    return [t for t in range(existence.shape[0]) if existence[t] >= sure and last_ns[t] == time_ns and not confirmed[t]]


def let_time_pass(
    double[:] existence,
    object[double, ndim=1, mode="strided"] unseen,
    object[double, ndim=1, mode="strided"] in_sight,
    double kept,
    double dt,
    double least,
):
    """Let in place probabilities of existence fade, and what could be seen wait longer."""
    cdef Py_ssize_t t
    with nogil:
        for t in range(existence.shape[0]):
            existence[t] = within(existence[t] * kept, least, 1.0 - least)
            unseen[t] = unseen[t] + dt * in_sight[t]


def note_detections(
    object[double, ndim=1, mode="strided"] interval,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    const Py_ssize_t[:] body,
    Py_ssize_t time_ns,
    double longest,
):
    """Note in place that bodies (m,), some twice, are detected at a time, and how long after their detections before."""
    cdef Py_ssize_t i
    with nogil:
        for i in range(body.shape[0]):
            interval[body[i]] = smaller(larger((time_ns - last_ns[body[i]]) * 1e-9, 0.0), longest)
        for i in range(body.shape[0]):
            last_ns[body[i]] = time_ns


def experience_of_bodies(
    object[Py_ssize_t, ndim=1, mode="strided"] sensors,
    object[Py_ssize_t, ndim=1, mode="strided"] history,
    object[double, ndim=1, mode="strided"] existence,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[unsigned char, ndim=1, mode="strided"] seen,
    Py_ssize_t sensor,
    double sure,
):
    """Return which bodies (k,) were missed by the scan before, which surely exist and have been detected by a sensor, a
    bit; and the rows of those detected by it before, and not seen now."""
    cdef Py_ssize_t k = len(sensors), t
    missed_array, surely_array = np.empty(k, np.bool_), np.empty(k, np.bool_)
    cdef object[unsigned char, ndim=1, mode="c"] missed = missed_array, surely = surely_array
    for t in range(k):
        missed[t] = history[t] & 1 == 0
        surely[t] = confirmed[t] and existence[t] > sure and sensors[t] & sensor != 0
    unseen = [t for t in range(k) if sensors[t] & sensor and not seen[t]]
    return missed_array, surely_array, np.array(unseen, np.intp)


def hand_over(
    Py_ssize_t[:] leader,
    const Py_ssize_t[:] body,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    Py_ssize_t time_ns,
    Py_ssize_t patience_ns,
):
    """Let in place the first reflection (n,) that is detected at a time lead bodies (k,) whose leading one is silent."""
    cdef Py_ssize_t i
    cdef bint some = False
    for i in range(leader.shape[0]):
        some = some or time_ns - last_ns[leader[i]] > patience_ns
    if not some:
        return
    silent_array = np.empty(leader.shape[0], np.bool_)
    cdef object[unsigned char, ndim=1, mode="c"] silent = silent_array
    for i in range(leader.shape[0]):
        silent[i] = time_ns - last_ns[leader[i]] > patience_ns
    for i in range(body.shape[0]):
        if last_ns[i] == time_ns and silent[body[i]]:
            leader[body[i]] = i
            silent[body[i]] = False


def stay_alongside(
    object[Py_ssize_t, ndim=1, mode="strided"] alongside_ns,
    const Py_ssize_t[:] older,
    object[double, ndim=1, mode="strided"] needed,
    Py_ssize_t dt_ns,
):
    """Note in place for how long bodies (k,) have been beside older ones, −1: there is none; return the rows of those that
    have been for the time needed, s."""
    cdef Py_ssize_t t
    merging = []
    for t in range(older.shape[0]):
        alongside_ns[t] = alongside_ns[t] + dt_ns if older[t] >= 0 else 0
        if older[t] >= 0 and alongside_ns[t] >= <Py_ssize_t>(needed[t] * 1e9):
            merging.append(t)
    return merging


def return_exponents(
    object[Py_ssize_t, ndim=1, mode="strided"] first_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    object[double, ndim=1, mode="strided"] interval,
    Py_ssize_t time_ns,
    double longest,
    double least,
):
    """Return by which powers of e the reference points of bodies (k,) keep away from where they belong: after the time
    since the detection before, if there is one now, over a time constant that is their age, within limits."""
    cdef Py_ssize_t k = len(last_ns), t
    cdef double time
    out_array = np.empty(k)
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            time = larger(smaller((time_ns - first_ns[t]) * 1e-9, longest), least)
            out[t] = -(interval[t] if last_ns[t] == time_ns else 0.0) / time
    return out_array


def step_references(
    const Py_ssize_t[:] body,
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=2, mode="strided"] target,
    object[double, ndim=1, mode="strided"] left,
    const double[:, :] axis,
):
    """Let reference points go to where they belong (k, 2), but for shares, 1 less, that are left; the offsets of their
    reflections change in place. Return the steps in the local frame."""
    cdef Py_ssize_t i, t
    cdef double ahead, aside
    out_array = np.empty((axis.shape[0], 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(axis.shape[0]):
            out[t, 0], out[t, 1] = -left[t] * target[t, 0], -left[t] * target[t, 1]
        for i in range(body.shape[0]):
            offset[i, 0] = offset[i, 0] - out[body[i], 0]
            offset[i, 1] = offset[i, 1] - out[body[i], 1]
        for t in range(axis.shape[0]):
            ahead, aside = out[t, 0], out[t, 1]
            out[t, 0] = ahead * axis[t, 0] - aside * axis[t, 1]
            out[t, 1] = aside * axis[t, 0] + ahead * axis[t, 1]
    return out_array


def shift_bodies(double[:, :, ::1] mean, double[:, :] overall, double[:, :] shown, const double[:, :] step):
    """Move in place the places of bodies in all modes (8, M, n), over them (n, 8) and as seen (n, 4) by steps (n, 2)."""
    cdef Py_ssize_t t, i, a
    with nogil:
        for a in range(2):
            for i in range(mean.shape[1]):
                for t in range(mean.shape[2]):
                    mean[a, i, t] = mean[a, i, t] + step[t, a]
            for t in range(mean.shape[2]):
                overall[t, a] = overall[t, a] + step[t, a]
                shown[t, a] = shown[t, a] + step[t, a]


def standing_reflections(
    const double[:, :] velocity,
    const double[:, :] sight,
    const double[:] distance,
    const Py_ssize_t[:] body,
    const unsigned char[:] confirmed,
    double radial,
    double any_way,
):
    """Return which reflections (m,) are of confirmed bodies (k,) that stand, by their speeds along lines of sight (m, 2),
    which are not yet divided by distances, and any way."""
    cdef Py_ssize_t m = body.shape[0], i, t
    cdef double along, far
    out_array = np.empty(m, np.bool_)
    cdef unsigned char[::1] out = out_array
    with nogil:
        for i in range(m):
            t, far = body[i], larger(distance[i], 1.0)
            along = velocity[t, 0] * (sight[i, 0] / far) + velocity[t, 1] * (sight[i, 1] / far)
            out[i] = (
                fabs(along) < radial
                and velocity[t, 0] * velocity[t, 0] + velocity[t, 1] * velocity[t, 1] < any_way
                and confirmed[t] != 0
            )
    return out_array


def look_up(object[Py_ssize_t, ndim=1, mode="strided"] table, const Py_ssize_t[:] ids):
    """Return what a table tells of ids (n,), one place further, and at its ends of what lies beyond; and whether they
    ascend."""
    cdef Py_ssize_t i, last = len(table) - 1
    cdef bint ascend = True
    rows_array = np.empty(ids.shape[0], np.intp)
    cdef object[Py_ssize_t, ndim=1, mode="c"] rows = rows_array
    for i in range(ids.shape[0]):
        rows[i] = table[min(max(ids[i], -1), last - 1) + 1]
        ascend = ascend and (i == 0 or ids[i] > ids[i - 1])
    return rows_array, ascend


def within_field(
    const double[:] bearing,
    const double[:] distance,
    double yaw,
    double opening,
    double least_range,
    double most_range,
    double half_turn,
):
    """Return which points (n,) lie in a field of view that opens to both sides of a direction."""
    cdef Py_ssize_t i
    cdef double azimuth
    out_array = np.empty(bearing.shape[0], np.bool_)
    cdef unsigned char[::1] out = out_array
    for i in range(bearing.shape[0]):
        azimuth = fmod(bearing[i] - yaw + half_turn, 2.0 * half_turn)
        if azimuth < 0.0:
            azimuth = azimuth + 2.0 * half_turn
        out[i] = least_range < distance[i] < most_range and fabs(azimuth - half_turn) < opening
    return out_array


def drive_modes(
    const double[:, :, ::1] driven, const double[:, :] standing, const double[:, :] turning, list times
):
    """Return what drives modes in a step (7, M, 1): what drives them in general, times those of the step; standing speeds
    (M, 1) are added to those, and the share of the turn rates (M, 1) is as given."""
    cdef Py_ssize_t a, i
    cdef double time
    out_array = np.empty((7, driven.shape[1], 1))
    cdef double[:, :, ::1] out = out_array
    for a in range(7):
        time = times[a]
        for i in range(driven.shape[1]):
            out[a, i, 0] = driven[a, i, 0] * time
    for i in range(driven.shape[1]):
        out[2, i, 0] = out[2, i, 0] + standing[i, 0]
        out[4, i, 0] = turning[i, 0]
    return out_array


def course(
    list samples, Py_ssize_t after, long long begin_ns, long long step_ns, Py_ssize_t count, double limit_ns
):
    """Return places, east + i north, and headings at even steps (count,); None where one is not between two samples that
    were heard, no further apart than a limit.

    A sample is its time, ns, east, north, heading, velocity east and north, yaw rate, two accelerations, and when it was
    heard, ns; the first that is later than the first step is at `after`.
    """
    cdef Py_ssize_t k, newest = len(samples) - 1
    cdef long long time_ns = begin_ns, earlier_ns = 0, later_ns = begin_ns
    cdef double dt, share, east = 0.0, north = 0.0, heading = 0.0, turned = 0.0
    cdef double ve = 0.0, vn = 0.0, faster_east = 0.0, faster_north = 0.0
    cdef tuple a, b
    places_array, headings_array = np.empty(count, np.complex128), np.empty(count)
    cdef double[:, ::1] places = places_array.view(float).reshape(count, 2)
    cdef double[::1] headings = headings_array
    for k in range(count):
        if time_ns >= later_ns:
            while after <= newest and <long long>(<tuple>samples[after])[0] <= time_ns:
                after += 1
            if not 0 < after <= newest:
                return None
            a, b = <tuple>samples[after - 1], <tuple>samples[after]
            earlier_ns, later_ns = a[0], b[0]
            if a[9] != a[0] or b[9] != b[0] or later_ns - earlier_ns > limit_ns:
                return None
            east, north, heading, ve, vn = a[1], a[2], a[3], a[4], a[5]
            turned, faster_east, faster_north = b[3] - heading, b[4] - ve, b[5] - vn
        dt = (time_ns - earlier_ns) * 1e-9
        share = dt / ((later_ns - earlier_ns) * 1e-9)
        places[k, 0] = east + dt * (ve + (ve + share * faster_east)) / 2.0
        places[k, 1] = north + dt * (vn + (vn + share * faster_north)) / 2.0
        headings[k] = heading + share * turned
        time_ns += step_ns
    return places_array, headings_array


def moments_of_path(
    const double[::1] distance,
    const double[::1] heading,
    const double complex[::1] unit,
    const double[::1] t,
    double scale,
    double bias,
    double step,
):
    """Return positions along a path at times (n,) and their derivatives with respect to the speed's scale, its offset and
    the yaw rate's bias (4, n); heading, speed, yaw rate and the rates of these two (5, n).

    Args:
        distance: between the path's steps (k - 1,).
        heading: at each (k,).
        unit: direction between them (k - 1,).
        t: s since the first step (n,).
        scale: of the speed.
        bias: of the yaw rate.
        step: s.
    """
    cdef Py_ssize_t k = heading.shape[0], n = t.shape[0], i, j, row
    cdef double middle, c, s, x, y, left, steps, share
    points_array, rates_array = np.empty((4, n), np.complex128), np.empty((5, n))
    cdef double[:, :, ::1] points = points_array.view(float).reshape(4, n, 2)
    cdef double[:, ::1] rates = rates_array
    summed_array, driven_array = np.zeros((6, k)), np.zeros((6, k))
    cdef double[:, ::1] summed = summed_array  # ahead, offset and turned, x and y of each
    cdef double[:, ::1] driven = driven_array  # distance, heading, and twice their rates
    with nogil:
        for i in range(k - 1):
            middle, c, s = step * (i + 0.5), unit[i].real, unit[i].imag
            x, y = distance[i] * c, distance[i] * s
            left = -scale * middle
            summed[0, i + 1], summed[1, i + 1] = summed[0, i] + x, summed[1, i] + y
            summed[2, i + 1], summed[3, i + 1] = summed[2, i] + step * c, summed[3, i] + step * s
            summed[4, i + 1], summed[5, i + 1] = summed[4, i] - left * y, summed[5, i] + left * x
            driven[0, i + 1] = driven[0, i] + distance[i]
        driven[1, :] = heading
        for row in range(2, 6):
            central_rates(driven[row - 2], 4 * step, driven[row])
        for i in range(n):
            steps = t[i] / step
            j = min(max(<Py_ssize_t>steps, 0), k - 2)
            share = steps - j
            for row in range(3):
                points[row + 1, i, 0] = between(summed[2 * row], j, share)
                points[row + 1, i, 1] = between(summed[2 * row + 1], j, share)
            points[0, i, 0], points[0, i, 1] = scale * points[1, i, 0], scale * points[1, i, 1]
            rates[0, i] = between(driven[1], j, share) - bias * t[i]
            rates[1, i] = scale * between(driven[2], j, share)
            rates[2, i] = between(driven[3], j, share) - bias
            rates[3, i] = scale * between(driven[4], j, share)
            rates[4, i] = between(driven[5], j, share)
    return points_array, rates_array


cdef inline void central_rates(const double[:] values, double time, double[:] rates) noexcept nogil:
    """Rates over two steps to each side, which take a time together, held at the ends."""
    cdef Py_ssize_t k = values.shape[0], i
    for i in range(2, k - 2):
        rates[i] = (values[i + 2] - values[i - 2]) / time
    rates[0] = rates[1] = rates[2]
    rates[k - 1] = rates[k - 2] = rates[k - 3]


cdef inline double between(const double[:] values, Py_ssize_t before, double share) noexcept nogil:
    return values[before] + share * (values[before + 1] - values[before])


def successions(
    const Py_ssize_t[::1] order,
    const long long[::1] object_id,
    const unsigned char[::1] new,
    const Py_ssize_t[::1] scan,
    const double[::1] since,
    const double complex[::1] place,
    double jump,
    double longest_gap,
):
    """Return where among measurements (n,), sorted by id and scan, each return begins, and how many are of it (k,).

    Args:
        order: rows of the measurements, sorted.
        object_id: of each row, the sensor's id.
        new: whether the sensor calls it another object than before.
        scan: number of the scan of each.
        since: time of each scan, s.
        place: over ground, m.
        jump: m², square of a distance from one to the next above which the return is another.
        longest_gap: s, likewise.
    """
    cdef Py_ssize_t n = order.shape[0], i, one, other, k = 0
    cdef double x, y
    first_array, count_array = np.empty(n, np.intp), np.empty(n, np.intp)
    cdef Py_ssize_t[::1] first = first_array, count = count_array
    with nogil:
        for i in range(n):
            one = order[i]
            if i:
                other = order[i - 1]
                x, y = place[one].real - place[other].real, place[one].imag - place[other].imag
            if (
                not i
                or new[one]
                or object_id[one] != object_id[other]
                or x * x + y * y > jump
                or since[scan[one]] - since[scan[other]] > longest_gap
            ):
                first[k], count[k] = i, 0
                k += 1
            count[k - 1] += 1
    return first_array[:k], count_array[:k]


cdef enum:
    QUANTITIES = 24  # of ego motion


cdef struct InsSetup:
    # which quantity: the clock, what was measured with it, and what else may be given; -1: it is not
    int clock, velocity_east, heading, yaw_rate, curvature, slip, ahead, left, valid
    unsigned int waits  # quantities that are waited for, one bit each
    long long longest_ns, latency_ns, age_limit_ns
    double age_limit, smoothing, arm_x, arm_y
    long long shortest_ns
    double early, late, fastest_turn, least_course_speed, sideways_share
    double bias_time, largest_bias, largest_change, straight, steady, settled, standing_speed, earliest


cdef struct InsMemory:
    double[QUANTITIES] value
    long long[QUANTITIES] arrived_ns
    long long[QUANTITIES] period_ns
    unsigned int known, waiting  # one bit each
    long long epoch_ns, heading_ns, heard_ns, last_ns, seen_ns
    bint is_open, has_heading, has_turn
    double heading, yaw_rate, bridged, curvature, sideways, given_turn, bias, bias_speed, followed, excess, excess_time
    double lately, steady
    double east, north, ve, vn, ae, an  # of the last sample
    long long samples, from_curvature, from_heading, accelerations


cdef inline bint knows(const InsMemory* own, int quantity) noexcept:
    return quantity >= 0 and own.known >> quantity & 1


cdef inline bint is_fresh(const InsMemory* own, const InsSetup* setup, int quantity) noexcept:
    """MotionEpoch.fresh"""
    cdef long long period
    if not knows(own, quantity):
        return False
    period = own.period_ns[quantity] or setup.longest_ns
    return own.epoch_ns - own.arrived_ns[quantity] <= setup.late * period


cdef inline bint is_of_epoch(const InsMemory* own, const InsSetup* setup, int quantity) noexcept:
    """MotionEpoch.belongs"""
    cdef long long age, period = own.period_ns[setup.clock] or setup.longest_ns
    if not knows(own, quantity):
        return False
    age = own.epoch_ns - own.arrived_ns[quantity]
    return (age if age >= 0 else -age) <= setup.early * period


cdef inline void begin_epoch(InsMemory* own, const InsSetup* setup, long long time_ns) noexcept:
    """MotionEpoch._begin, for a clock that is known"""
    cdef long long interval = time_ns - own.arrived_ns[setup.clock], age, due
    cdef long long period = own.period_ns[setup.clock] or min(interval, setup.longest_ns)
    cdef bint paused = interval > setup.late * period
    cdef int k
    own.epoch_ns, own.is_open, own.waiting = time_ns, True, 0
    for k in range(QUANTITIES):
        if setup.waits & own.known & 1u << k:
            age = time_ns - own.arrived_ns[k]
            due = own.period_ns[k] or period
            if age >= setup.early * due and (paused or age <= setup.late * due):
                own.waiting |= 1u << k


cdef inline void hear(InsMemory* own, const InsSetup* setup, int quantity, double value, long long time_ns) noexcept:
    """Take a quantity that is known, as MotionEpoch.take does."""
    cdef long long interval = time_ns - own.arrived_ns[quantity], before = own.period_ns[quantity]
    if interval > setup.shortest_ns and interval != before:
        interval = min(interval, setup.longest_ns)
        own.period_ns[quantity] = before + ((min(interval, 2 * before) - before) >> 2) if before else interval
    own.value[quantity], own.arrived_ns[quantity] = value, time_ns
    own.waiting &= ~(1u << quantity)


cdef inline double unbiased(
    const InsMemory* own, const InsSetup* setup, double turn, double speed, bint by_curvature, bint usual
) noexcept:
    """TurnBias.unbiased"""
    speed = fabs(speed)
    if not usual or (turn == 0.0 and speed < setup.standing_speed):
        return turn
    if by_curvature and speed < own.bias_speed:
        return turn - own.bias * (speed / own.bias_speed)
    return turn - own.bias


cdef inline void follow_bias(
    InsMemory* own, const InsSetup* setup, double given, double speed, double change, double dt
) noexcept:
    """TurnBias.follow"""
    cdef double excess, time, share
    cdef bint turns, is_steady, is_large
    if not own.has_turn:
        own.excess = own.excess_time = 0.0
        return
    if given == 0.0 and fabs(speed) < setup.standing_speed:
        return
    own.lately += dt / (dt + setup.settled) * (given - own.lately)
    turns = larger(fabs(given), fabs(own.given_turn)) >= setup.straight
    own.steady = 0.0 if turns and fabs(given - own.lately) >= setup.steady else own.steady + dt
    own.excess += (given + own.given_turn) / 2 * dt - change
    own.excess_time += dt
    excess, time = own.excess, own.excess_time
    is_steady = own.steady >= setup.settled and setup.bias_time > 0.0
    is_large = fabs(excess) >= setup.largest_change + setup.largest_bias * time
    if is_steady and is_large and time < setup.settled:
        return
    own.excess = own.excess_time = 0.0
    if not is_steady or is_large:
        return
    own.followed = smaller(own.followed + time, setup.bias_time)
    share = time / (time + larger(own.followed, setup.earliest))
    own.bias += share * (excess / time - own.bias)
    own.bias = larger(-setup.largest_bias, smaller(own.bias, setup.largest_bias))
    own.bias_speed += share * (fabs(speed) - own.bias_speed)


cdef void hear_heading(
    InsMemory* own, const InsSetup* setup, long long time_ns, bint usual, double given, double speed
):
    """InsMotion._hear_heading and ._derive_turn"""
    cdef double heading = M_PI / 2 - own.value[setup.heading], change, dt, share
    own.heard_ns, own.bridged = own.arrived_ns[setup.heading], 0.0
    if own.has_heading:
        change = remainder(heading - own.heading, 2 * M_PI)
        heading = own.heading + change
        dt = (time_ns - own.heading_ns) * 1e-9
        if dt > setup.age_limit:
            own.yaw_rate = 0.0
        elif dt > 0.0 and fabs(change) <= setup.fastest_turn * dt:
            share = dt / (dt + setup.smoothing)
            own.yaw_rate += share * (change / dt - own.yaw_rate)
        if usual and 0.0 < dt <= setup.age_limit:
            follow_bias(own, setup, given, speed, change, dt)
    own.heading, own.heading_ns, own.has_heading = heading, time_ns, True
    own.given_turn, own.has_turn = given, usual


cdef bint add_sample(InsMemory* own, const InsSetup* setup, list rows, type kind) except -1:
    """InsMotion._add_sample and MotionHistory.add; return False where those are needed, and what is changed is void."""
    cdef bint turns, heard = False, components = setup.velocity_east >= 0, accelerates = False
    cdef bint by_curvature = False, usual = True
    cdef double ve = 0.0, vn = 0.0, speed, turn = 0.0, heading, course, slip, c, s, ahead, left, dt, share
    cdef double east_rate = 0.0, north_rate = 0.0
    cdef long long time_ns = own.epoch_ns - setup.latency_ns
    if knows(own, setup.valid) and own.value[setup.valid] == 0.0:
        return True
    if components and not is_of_epoch(own, setup, setup.velocity_east):
        return True
    speed = own.value[setup.clock]
    if components:
        ve, vn = own.value[setup.velocity_east], speed
        speed = hypot(ve, vn)
    turns = is_fresh(own, setup, setup.yaw_rate)
    if turns:
        turn = own.value[setup.yaw_rate]
    elif is_fresh(own, setup, setup.curvature):
        turns, by_curvature, turn = True, True, own.value[setup.curvature] * speed
        usual = setup.yaw_rate < 0
        own.from_curvature += 1
    if knows(own, setup.heading) and own.arrived_ns[setup.heading] != own.heard_ns:
        heard = True
        if is_of_epoch(own, setup, setup.heading):
            hear_heading(own, setup, time_ns, turns and usual, turn, speed)
        else:
            hear_heading(own, setup, own.arrived_ns[setup.heading] - setup.latency_ns, turns and usual, turn, speed)
    elif own.has_heading and not is_fresh(own, setup, setup.heading):
        return False
    if not own.has_heading:
        return True
    if turns:
        turn = unbiased(own, setup, turn, speed, by_curvature, usual)
    heading = own.heading + (turn if turns else own.yaw_rate) * ((time_ns - own.heading_ns) * 1e-9)
    own.samples += 1
    if not turns:
        turn = own.yaw_rate
        own.from_heading += 1
    if not components:
        if is_fresh(own, setup, setup.slip):
            slip = own.value[setup.slip]
        else:
            slip = turn * setup.arm_x
            slip = asin(slip / speed) if fabs(slip) < fabs(speed) else 0.0
        course = heading + slip
        ve, vn = speed * cos(course), speed * sin(course)
    c, s = cos(heading), sin(heading)
    ve += turn * (s * setup.arm_x + c * setup.arm_y)
    vn -= turn * (c * setup.arm_x - s * setup.arm_y)
    if fabs(speed) >= setup.least_course_speed:
        own.curvature = turn / speed
        if heard:
            own.sideways += setup.sideways_share * (vn * c - ve * s - own.sideways)
    if is_fresh(own, setup, setup.ahead):
        ahead = own.value[setup.ahead]
        left = own.value[setup.left] if is_fresh(own, setup, setup.left) else speed * turn
        own.accelerations += 1
        east_rate, north_rate, accelerates = c * ahead - s * left, s * ahead + c * left, True
    dt = (time_ns - own.last_ns) * 1e-9
    if dt <= 0.0:
        return True
    if (time_ns - own.seen_ns) * 1e-9 > setup.age_limit:
        return False
    share = dt / (dt + setup.smoothing)
    own.east = own.east + dt * (own.ve + ve) / 2
    own.north = own.north + dt * (own.vn + vn) / 2
    own.ae = own.ae + share * ((ve - own.ve) / dt - own.ae)
    own.an = own.an + share * ((vn - own.vn) / dt - own.an)
    if accelerates:
        own.ae, own.an = east_rate, north_rate
    own.ve, own.vn, own.last_ns, own.seen_ns = ve, vn, time_ns, time_ns
    rows.append(
        tuple.__new__(kind, (time_ns, own.east, own.north, heading, ve, vn, turn, own.ae, own.an, time_ns))
    )
    return True


cdef class InsEpochs:
    """What an INS remembers, and the frames of many that it takes, up to the first that asks for more than a steady drive.

    Quantities are numbers below `QUANTITIES`. The roles are those of the clock, velocity_east, heading, yaw_rate,
    curvature, slip, ax, ay and valid, -1 for what is not given; `waits` has a bit of each that is waited for.
    """

    cdef InsSetup setup
    cdef InsMemory own
    cdef Py_ssize_t quantities
    cdef const long long[::1] times
    cdef const Py_ssize_t[::1] message
    cdef const double[:, ::1] values
    cdef const Py_ssize_t[:, ::1] columns

    def __init__(self, tuple roles, unsigned int waits, tuple limits):
        (
            self.setup.clock, self.setup.velocity_east, self.setup.heading, self.setup.yaw_rate, self.setup.curvature,
            self.setup.slip, self.setup.ahead, self.setup.left, self.setup.valid,
        ) = roles
        (
            self.setup.longest_ns, self.setup.latency_ns, self.setup.age_limit_ns, self.setup.age_limit,
            self.setup.smoothing, self.setup.arm_x, self.setup.arm_y, self.setup.shortest_ns, self.setup.early,
            self.setup.late, self.setup.fastest_turn, self.setup.least_course_speed, self.setup.sideways_share,
            self.setup.bias_time, self.setup.largest_bias, self.setup.largest_change, self.setup.straight,
            self.setup.steady, self.setup.settled, self.setup.standing_speed, self.setup.earliest,
        ) = limits
        self.setup.waits = waits

    def keep(
        self,
        const long long[::1] times,
        const Py_ssize_t[::1] message,
        const double[:, ::1] values,
        const Py_ssize_t[:, ::1] columns,
    ):
        """Keep frames: of each the time, ns, the message, and values, whose quantities `columns` names, -1 after the last."""
        self.times, self.message, self.values, self.columns = times, message, values, columns

    def load(self, list signals, unsigned int waiting, tuple memory, last):
        """Remember of each quantity its value, time and period, or None before its first; and the newest sample."""
        cdef int k
        cdef InsMemory* own = &self.own
        self.quantities, own.known = len(signals), 0
        for k in range(self.quantities):
            if signals[k] is not None:
                own.known |= 1u << k
                own.value[k], own.arrived_ns[k], own.period_ns[k] = signals[k]
        own.waiting = waiting
        own.has_heading = memory[2] is not None
        own.heading = memory[2] if own.has_heading else 0.0
        own.epoch_ns, own.is_open = memory[0], memory[1]
        own.heading_ns, own.yaw_rate, own.heard_ns, own.bridged, own.curvature, own.sideways = memory[3:9]
        bias = memory[9]
        own.has_turn = bias[0] is not None
        own.given_turn = bias[0] if own.has_turn else 0.0
        own.bias, own.bias_speed, own.followed, own.lately, own.steady, own.excess, own.excess_time = bias[1:]
        own.last_ns, own.east, own.north, _, own.ve, own.vn, _, own.ae, own.an, own.seen_ns = last
        own.samples = own.from_curvature = own.from_heading = own.accelerations = 0

    def memory(self):
        """Return what is remembered, as it is loaded, and how often what was counted since."""
        cdef int k
        cdef InsMemory* own = &self.own
        return (
            [
                (own.value[k], own.arrived_ns[k], own.period_ns[k]) if own.known >> k & 1 else None
                for k in range(self.quantities)
            ],
            own.waiting,
            (
                own.epoch_ns, bool(own.is_open), own.heading if own.has_heading else None, own.heading_ns, own.yaw_rate,
                own.heard_ns, own.bridged, own.curvature, own.sideways,
                (
                    own.given_turn if own.has_turn else None, own.bias, own.bias_speed, own.followed, own.lately,
                    own.steady, own.excess, own.excess_time,
                ),
            ),
            (own.samples, own.from_curvature, own.from_heading, own.accelerations),
        )

    def take(self, Py_ssize_t begin, Py_ssize_t end, type kind):
        """Take the kept frames from `begin` to before `end`; return up to which, and the samples made, of their kind."""
        cdef const InsSetup* setup = &self.setup
        cdef InsMemory* own = &self.own
        cdef InsMemory before
        cdef Py_ssize_t i, column, m, made
        cdef int k
        cdef long long time_ns
        cdef bint is_clock, has_heading, steady = knows(own, setup.clock)
        cdef double value
        cdef list rows = []
        if not steady:
            return begin, rows
        for i in range(begin, end):
            before, made = own[0], len(rows)
            time_ns, m = self.times[i], self.message[i]
            if self.columns[m, 0] < 0:
                continue
            is_clock = has_heading = False
            for column in range(self.columns.shape[1]):
                k = self.columns[m, column]
                if k < 0:
                    break
                is_clock = is_clock or k == setup.clock
                has_heading = has_heading or k == setup.heading
            if own.is_open and is_clock:
                steady = add_sample(own, setup, rows, kind)
            for column in range(self.columns.shape[1]):
                k = self.columns[m, column]
                if k < 0 or not steady:
                    break
                value = self.values[i, column]
                if value != value:
                    continue
                if k == setup.clock:
                    begin_epoch(own, setup, time_ns)
                steady = knows(own, k)
                hear(own, setup, k, value, time_ns)
            if steady and own.is_open and not own.waiting:
                own.is_open = False
                steady = add_sample(own, setup, rows, kind)
            elif has_heading and time_ns - own.epoch_ns > setup.age_limit_ns:
                steady = False
            if not steady:
                own[0] = before
                del rows[made:]
                return i, rows
        return end, rows


def offsets_of_reflections(
    object[double, ndim=2, mode="strided"] offset,
    object[double, ndim=2, mode="strided"] axis,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[Py_ssize_t, ndim=1, mode="strided"] rows,
):
    """Return the offsets of reflections, by their rows (m,), in the local frame (m, 2); they are along and across the
    axes of their bodies (k, 2)."""
    cdef Py_ssize_t m = len(rows), i, r, t
    out_array = np.empty((m, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for i in range(m):
            r = rows[i]
            t = body[r]
            out[i, 0] = offset[r, 0] * axis[t, 0] - offset[r, 1] * axis[t, 1]
            out[i, 1] = offset[r, 1] * axis[t, 0] + offset[r, 0] * axis[t, 1]
    return out_array


def arms_of_reflections(
    object[double, ndim=2, mode="strided"] shown,
    object[double, ndim=2, mode="strided"] offset,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=2, mode="strided"] pivot,
    object[double, ndim=1, mode="strided"] variance,
):
    """Return how far from the pivots of their bodies (k, 2) reflections lie (m, 2), an offset from where those are shown
    (k, 4); zero where the turn rate has no variance."""
    cdef Py_ssize_t m = len(body), i, t
    cdef double known
    cdef int a
    out_array = np.empty((m, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for i in range(m):
            t = body[i]
            known = 1.0 if variance[t] > 0.0 else 0.0
            for a in range(2):
                out[i, a] = (shown[t, a] + offset[i, a] - pivot[t, a]) * known
    return out_array


def sure_swings(
    object[double, ndim=2, mode="strided"] mean,
    object[double, ndim=1, mode="strided"] standing,
    object[double, ndim=1, mode="strided"] rate,
    object[double, ndim=1, mode="strided"] variance,
    object[double, ndim=2, mode="strided"] pivot,
    double deviations,
    double dt,
):
    """Return by which steps the reference points of bodies (k, 2) swing about their pivots in a time, by what of their
    turn rates is beyond so many deviations, as far as they do not stand; None: none does."""
    cdef Py_ssize_t k = len(rate), t
    cdef double turn, x, y
    cdef bint turns = False, swings = False
    out_array = np.empty((k, 2))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            turn = larger(fabs(rate[t]) - deviations * sqrt(variance[t]), 0.0)
            turn = copysign((1.0 - standing[t]) * turn, rate[t])
            x = turn * -(mean[t, 1] - pivot[t, 1])
            y = turn * (mean[t, 0] - pivot[t, 0])
            turns = turns or turn != 0.0
            swings = swings or x != 0.0 or y != 0.0
            out[t, 0], out[t, 1] = dt * x, dt * y
    return out_array if turns and swings else None


def lies_far_along(
    object[double, ndim=2, mode="strided"] offset,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[unsigned char, ndim=1, mode="strided"] confirmed,
    object[unsigned char, ndim=1, mode="strided"] directed,
    object[double, ndim=1, mode="strided"] fastest,
    double slower,
    double far,
):
    """Return whether any reflection of a confirmed, directed and slower body lies farther along it than that."""
    cdef Py_ssize_t n = len(body), i, t
    for i in range(n):
        if fabs(offset[i, 0]) > far:
            t = body[i]
            if confirmed[t] and directed[t] and fastest[t] < slower:
                return True
    return False


def widest_across(object[double, ndim=2, mode="strided"] offset):
    """Return how far apart across the first and the last of reflections lie, whatever their bodies; −1 of none."""
    cdef Py_ssize_t n = len(offset), i
    cdef double low = INFINITY, high = -INFINITY
    for i in range(n):
        low, high = smaller(low, offset[i, 1]), larger(high, offset[i, 1])
    return high - low if n else -1.0


def turns_of_modes(double[:, :, ::1] mean, const double[:, :, ::1] drive, Py_ssize_t component, Py_ssize_t time, double most):
    """Keep the turn rates, a component of means (8, M, n), within limits in place; return by how much bodies turn in the
    time that a row of what drives modes (7, M, 1) tells: (M, n)."""
    cdef Py_ssize_t modes = mean.shape[1], n = mean.shape[2], i, t
    out_array = np.empty((modes, n))
    cdef double[:, ::1] out = out_array
    with nogil:
        for i in range(modes):
            for t in range(n):
                mean[component, i, t] = smaller(larger(mean[component, i, t], -most), most)
                out[i, t] = mean[component, i, t] * drive[time, i, 0]
    return out_array


def loosen_offsets(
    object[double, ndim=1, mode="strided"] variance,
    object[Py_ssize_t, ndim=1, mode="strided"] leader,
    double kept,
    double added,
):
    """Let variances of offsets (n,) return to where they come from, in place: a share is kept, and so much added; those of
    leading reflections, by their rows (k,), are zero."""
    cdef Py_ssize_t n = len(variance), k = len(leader), i
    with nogil:
        for i in range(n):
            variance[i] = kept * variance[i] + added
        for i in range(k):
            variance[leader[i]] = 0.0


def steps_of_trails(
    object[Py_ssize_t, ndim=1, mode="strided"] trail_ns,
    object[Py_ssize_t, ndim=1, mode="strided"] rows,
    object[Py_ssize_t, ndim=1, mode="strided"] body,
    object[double, ndim=1, mode="strided"] fastest,
    Py_ssize_t time_ns,
    double walking,
    double patience,
    double patience_with_vehicles,
    double least,
):
    """Return how long ago reflections, by their rows (m,) and those of their bodies (m,), were followed last, s, kept
    within limits (m,); and whether that is longer than the patience (m,), another one with bodies that were faster than
    who walks."""
    cdef Py_ssize_t m = len(rows), i
    cdef double passed, most
    dt_array, lost_array = np.empty(m), np.empty(m, np.bool_)
    cdef object[double, ndim=1, mode="c"] dt = dt_array
    cdef object[unsigned char, ndim=1, mode="c"] lost = lost_array
    with nogil:
        for i in range(m):
            passed = (time_ns - trail_ns[rows[i]]) * 1e-9
            most = patience if fastest[body[i]] < walking else patience_with_vehicles
            lost[i] = passed > most
            dt[i] = smaller(larger(passed, least), most)
    return dt_array, lost_array


def detected_after(
    object[double, ndim=1, mode="strided"] interval,
    object[Py_ssize_t, ndim=1, mode="strided"] last_ns,
    Py_ssize_t time_ns,
):
    """Return the intervals (k,) before what was detected at a time, 0 of the rest."""
    cdef Py_ssize_t k = len(interval), t
    out_array = np.empty(k)
    cdef object[double, ndim=1, mode="c"] out = out_array
    with nogil:
        for t in range(k):
            out[t] = interval[t] if last_ns[t] == time_ns else 0.0
    return out_array


def scaled_noise(object[double, ndim=3, mode="strided"] noise, object[double, ndim=1, mode="strided"] factor):
    """Return covariances (m, 2, 2), multiplied by a factor each (m,)."""
    cdef Py_ssize_t m = len(noise), i
    cdef int a, b
    out_array = np.empty((m, 2, 2))
    cdef object[double, ndim=3, mode="c"] out = out_array
    with nogil:
        for i in range(m):
            for a in range(2):
                for b in range(2):
                    out[i, a, b] = noise[i, a, b] * factor[i]
    return out_array


def possible_sizes(object[double, ndim=2, mode="strided"] values, Py_ssize_t row, double most):
    """Return quantities (Q, n) with NaN for what in a row is no size, None where all are; and how many are odd: neither
    sizes nor NaN."""
    cdef Py_ssize_t quantities = len(values), n = (<object>values).shape[1], q, t, odd = 0
    cdef bint all_are = True
    for t in range(n):
        if not (values[row, t] > 0.0 and values[row, t] <= most):
            all_are = False
            odd += values[row, t] == values[row, t]
    if all_are:
        return None, 0
    out_array = np.empty((quantities, n))
    cdef object[double, ndim=2, mode="c"] out = out_array
    with nogil:
        for q in range(quantities):
            for t in range(n):
                out[q, t] = values[q, t]
        for t in range(n):
            if not (values[row, t] > 0.0 and values[row, t] <= most):
                out[row, t] = NAN
    return out_array, odd
