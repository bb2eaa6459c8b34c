/* SPDX-License-Identifier: Apache-2.0
 *
 * Inner loops of the control step, compiled; see wam_power_ros/compiled.py.
 *
 * Each function does what the Python code beside its call does, in the same order of operations, so
 * that both give the same numbers bit for bit; only `torque_check` sums in another order than the
 * BLAS. None has a constant of its own. None changes an argument. What would be a fault is answered
 * with None or False, and the Python code computes it again and names it. Lists hold floats, or
 * counts where it says so; "array" is anything with a contiguous buffer of doubles.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>

#define JOINTS_MAX 64 /* as in control/arm.py */

static int floats(PyObject *list, double *values, Py_ssize_t n)
{
    if (!PyList_Check(list) || PyList_GET_SIZE(list) != n) {
        PyErr_SetString(PyExc_ValueError, "a list of one number for each joint is needed");
        return 0;
    }
    for (Py_ssize_t i = 0; i < n; i++) {
        values[i] = PyFloat_AsDouble(PyList_GET_ITEM(list, i));
        if (values[i] == -1.0 && PyErr_Occurred())
            return 0;
    }
    return 1;
}

static PyObject *list_of(const double *values, Py_ssize_t n)
{
    PyObject *list = PyList_New(n);
    for (Py_ssize_t i = 0; list != NULL && i < n; i++) {
        PyObject *value = PyFloat_FromDouble(values[i]);
        if (value == NULL) {
            Py_CLEAR(list);
            break;
        }
        PyList_SET_ITEM(list, i, value);
    }
    return list;
}

/* Copy an array of `count` doubles; a matrix comes in the order of its memory. */
static int doubles(PyObject *array, double *values, Py_ssize_t count)
{
    Py_buffer view;
    if (PyObject_GetBuffer(array, &view, PyBUF_ANY_CONTIGUOUS) < 0)
        return 0;
    int fits = view.itemsize == sizeof(double) && view.len == count * (Py_ssize_t)sizeof(double);
    if (fits)
        memcpy(values, view.buf, view.len);
    else
        PyErr_SetString(PyExc_ValueError, "an array of doubles has the wrong size");
    PyBuffer_Release(&view);
    return fits;
}

static int argument_count(Py_ssize_t given, Py_ssize_t needed)
{
    if (given == needed)
        return 1;
    PyErr_Format(PyExc_TypeError, "%zd arguments are needed, not %zd", needed, given);
    return 0;
}

static Py_ssize_t joint_count(PyObject *list)
{
    Py_ssize_t n = PyList_Check(list) ? PyList_GET_SIZE(list) : 0;
    if (n < 1 || n > JOINTS_MAX) {
        PyErr_SetString(PyExc_ValueError, "a list of 1 to 64 numbers is needed");
        return 0;
    }
    return n;
}

PyDoc_STRVAR(velocity_check_doc,
"velocity_check(q_before, q, qd_before, qd, unchanged, lagged, moved, mismatches, dt, shortest,\n"
"    longest, constants)\n--\n\n"
"New (lagged, moved, mismatches) of `VelocityCheck`; None if the state is beyond a bound.\n"
"`unchanged` holds counts, `mismatches` one list for each window.");

static PyObject *velocity_check(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double q_before[JOINTS_MAX], q[JOINTS_MAX], qd_before[JOINTS_MAX], qd[JOINTS_MAX];
    double lagged[JOINTS_MAX], previous[JOINTS_MAX], moved[JOINTS_MAX], added[JOINTS_MAX];
    double unchanged[JOINTS_MAX];
    double lag, leap, per_state, share, standstill, slow_speed, windows[2], bounds[2];
    Py_ssize_t n;
    if (!argument_count(nargs, 12) || !(n = joint_count(args[0])))
        return NULL;
    if (!floats(args[0], q_before, n) || !floats(args[1], q, n) || !floats(args[2], qd_before, n)
        || !floats(args[3], qd, n) || !floats(args[4], unchanged, n)
        || !floats(args[5], lagged, n) || !floats(args[6], previous, n))
        return NULL;
    if (!PyList_Check(args[7]) || PyList_GET_SIZE(args[7]) != 2) {
        PyErr_SetString(PyExc_ValueError, "mismatches of two windows are needed");
        return NULL;
    }
    double dt = PyFloat_AsDouble(args[8]);
    double half_short = 0.5 * PyFloat_AsDouble(args[9]);
    double half_long = 0.5 * PyFloat_AsDouble(args[10]);
    if (PyErr_Occurred()
        || !PyArg_ParseTuple(args[11], "dddddddddd", &lag, &leap, &per_state, &share, &standstill,
                             &slow_speed, &windows[0], &bounds[0], &windows[1], &bounds[1]))
        return NULL;
    double keep = exp(-dt / lag);
    for (Py_ssize_t i = 0; i < n; i++) {
        double speeds = qd_before[i] + qd[i], least, most, slow;
        moved[i] = q[i] - q_before[i];
        double change = moved[i], late = keep * lagged[i] + (1.0 - keep) * change;
        lagged[i] = late;
        if (speeds > 0.0) {
            least = half_short * speeds;
            most = half_long * speeds;
            slow = least;
        } else {
            least = half_long * speeds;
            most = half_short * speeds;
            slow = -most;
        }
        double low = change < late ? change : late, high = change < late ? late : change;
        double mismatch = low > most ? low - most : high < least ? least - high : 0.0;
        double size = fabs(change);
        if (change * previous[i] < 0.0) {
            double back = fabs(previous[i]) < size ? fabs(previous[i]) : size;
            mismatch = back > mismatch ? back : mismatch;
        }
        if (fabs(change - most) > leap)
            mismatch = per_state > mismatch ? per_state : mismatch;
        if (unchanged[i] >= standstill && fabs(qd[i]) > slow_speed)
            Py_RETURN_NONE;
        added[i] = (mismatch < per_state ? mismatch : per_state)
                   - share * (size < slow ? size : slow);
    }
    double sums[2][JOINTS_MAX];
    for (int k = 0; k < 2; k++) {
        if (!floats(PyList_GET_ITEM(args[7], k), sums[k], n))
            return NULL;
        double decay = exp(-dt / windows[k]);
        for (Py_ssize_t i = 0; i < n; i++) {
            sums[k][i] = decay * sums[k][i] + added[i];
            if (!(sums[k][i] <= bounds[k]))
                Py_RETURN_NONE;
        }
    }
    return Py_BuildValue("(NN[NN])", list_of(lagged, n), list_of(moved, n), list_of(sums[0], n),
                         list_of(sums[1], n));
}

PyDoc_STRVAR(torque_check_doc,
"torque_check(mass, bias, sent, qd_before, qd, unchanged, residual, inertial, moving, standing,\n"
"    lag, dt, constants)\n--\n\n"
"New (residual, inertial, stepped) of `TorqueCheck`; None if a joint is beyond its bound.\n"
"`mass`, `bias` and `sent`, the latest torques, are arrays, `unchanged` holds counts.");

static PyObject *torque_check(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double mass[JOINTS_MAX * JOINTS_MAX], bias[JOINTS_MAX], low[JOINTS_MAX], high[JOINTS_MAX];
    double lists[11][JOINTS_MAX];
    double *qd_before = lists[0], *qd = lists[1], *unchanged = lists[2], *residual = lists[3];
    double *inertial = lists[4], *moving = lists[5], *standing_bound = lists[6];
    double *friction = lists[7], *damping = lists[8], *full = lists[9], *allowed = lists[10];
    double time_constant, friction_speed, standstill;
    PyObject *constants[4];
    Py_ssize_t n;
    if (!argument_count(nargs, 13) || !(n = joint_count(args[3])))
        return NULL;
    for (int k = 0; k < 7; k++)
        if (!floats(args[3 + k], lists[k], n))
            return NULL;
    double lag = PyFloat_AsDouble(args[10]), dt = PyFloat_AsDouble(args[11]);
    if (PyErr_Occurred()
        || !PyArg_ParseTuple(args[12], "dddOOOO", &time_constant, &friction_speed, &standstill,
                             &constants[0], &constants[1], &constants[2], &constants[3]))
        return NULL;
    for (int k = 0; k < 4; k++)
        if (!floats(constants[k], lists[7 + k], n))
            return NULL;
    double keep = exp(-dt / time_constant), share = 1.0 - keep;
    if (!doubles(args[0], mass, n * n) || !doubles(args[1], bias, n))
        return NULL;
    Py_buffer sent;
    if (PyObject_GetBuffer(args[2], &sent, PyBUF_C_CONTIGUOUS) < 0)
        return NULL;
    Py_ssize_t rows = sent.len / (Py_ssize_t)sizeof(double) / n;
    for (Py_ssize_t i = 0; i < n; i++) {
        const double *torque = (const double *)sent.buf + i;
        low[i] = high[i] = *torque;
        for (Py_ssize_t k = 1; k < rows; k++) {
            torque += n;
            low[i] = *torque < low[i] ? *torque : low[i];
            high[i] = *torque > high[i] ? *torque : high[i];
        }
    }
    PyBuffer_Release(&sent);
    int stepped = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        double accelerating = 0.0;
        for (Py_ssize_t k = 0; k < n; k++)
            accelerating += mass[i * n + k] * (qd[k] - qd_before[k]);
        accelerating /= dt;
        double need = accelerating + bias[i]
                      + (friction[i] * tanh(qd[i] / friction_speed) + damping[i] * qd[i]);
        double torque = fabs(accelerating);
        if (torque > full[i])
            stepped = 1;
        double beyond = need < low[i] ? need - low[i] : need > high[i] ? need - high[i] : 0.0;
        residual[i] = keep * residual[i] + share * beyond;
        inertial[i] = keep * inertial[i] + share * torque;
        double bound = unchanged[i] >= standstill ? standing_bound[i] : moving[i];
        double excess = fabs(residual[i]) - lag * inertial[i] - allowed[i] - bound;
        if (!(excess <= 0.0))
            Py_RETURN_NONE;
    }
    return Py_BuildValue("(NNO)", list_of(residual, n), list_of(inertial, n),
                         stepped ? Py_True : Py_False);
}

PyDoc_STRVAR(within_doc,
"within(values, rows)\n--\n\n"
"Whether low <= value <= high for each value of an array and its row, a list [low, high].");

static PyObject *within(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double values[JOINTS_MAX], row[2];
    Py_ssize_t n;
    if (!argument_count(nargs, 2) || !(n = joint_count(args[1])) || !doubles(args[0], values, n))
        return NULL;
    for (Py_ssize_t i = 0; i < n; i++) {
        if (!floats(PyList_GET_ITEM(args[1], i), row, 2))
            return NULL;
        if (!(row[0] <= values[i] && values[i] <= row[1]))
            Py_RETURN_FALSE;
    }
    Py_RETURN_TRUE;
}

PyDoc_STRVAR(torque_within_doc,
"torque_within(tau, previous, rows, dt)\n--\n\n"
"Whether torques (arrays) keep the limits of magnitude and rate, lists [peak, rate].");

static PyObject *torque_within(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double tau[JOINTS_MAX], previous[JOINTS_MAX], row[2];
    Py_ssize_t n;
    if (!argument_count(nargs, 4) || !(n = joint_count(args[2])) || !doubles(args[0], tau, n)
        || !doubles(args[1], previous, n))
        return NULL;
    double dt = PyFloat_AsDouble(args[3]);
    if (dt == -1.0 && PyErr_Occurred())
        return NULL;
    for (Py_ssize_t i = 0; i < n; i++) {
        if (!floats(PyList_GET_ITEM(args[2], i), row, 2))
            return NULL;
        double change = row[1] * dt;
        if (!(previous[i] - change <= tau[i] && tau[i] <= previous[i] + change && -row[0] <= tau[i]
              && tau[i] <= row[0]))
            Py_RETURN_FALSE;
    }
    Py_RETURN_TRUE;
}

PyDoc_STRVAR(joints_within_doc,
"joints_within(q, qd, rows, outwards)\n--\n\n"
"Whether joints keep their limits, lists [low, high, speed]: no speed is above its limit, and none\n"
"above `outwards` leads further out of the range.");

static PyObject *joints_within(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double q[JOINTS_MAX], qd[JOINTS_MAX], row[3];
    Py_ssize_t n;
    if (!argument_count(nargs, 4) || !(n = joint_count(args[2])) || !floats(args[0], q, n)
        || !floats(args[1], qd, n))
        return NULL;
    double outwards = PyFloat_AsDouble(args[3]);
    if (outwards == -1.0 && PyErr_Occurred())
        return NULL;
    for (Py_ssize_t i = 0; i < n; i++) {
        if (!floats(PyList_GET_ITEM(args[2], i), row, 3))
            return NULL;
        if (!(-row[2] <= qd[i] && qd[i] <= row[2]) || (q[i] > row[1] && qd[i] > outwards)
            || (q[i] < row[0] && qd[i] < -outwards))
            Py_RETURN_FALSE;
    }
    Py_RETURN_TRUE;
}

PyDoc_STRVAR(rotation_vector_doc,
"rotation_vector(matrix, tiny)\n--\n\n"
"Rotation vector, three floats, of a rotation matrix (3, 3) of doubles in any layout.");

static int rotation(PyObject *array, double m[9])
{
    Py_buffer view;
    if (PyObject_GetBuffer(array, &view, PyBUF_STRIDES) < 0)
        return 0;
    int fits = view.ndim == 2 && view.shape[0] == 3 && view.shape[1] == 3
               && view.itemsize == sizeof(double);
    for (int i = 0; fits && i < 9; i++) {
        const char *place = (const char *)view.buf;
        m[i] = *(const double *)(place + i / 3 * view.strides[0] + i % 3 * view.strides[1]);
    }
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "a matrix (3, 3) of doubles is needed");
    PyBuffer_Release(&view);
    return fits;
}

static PyObject *rotation_vector(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    double m[9], x, y, z, w;
    if (!argument_count(nargs, 2) || !rotation(args[0], m))
        return NULL;
    double tiny = PyFloat_AsDouble(args[1]);
    if (tiny == -1.0 && PyErr_Occurred())
        return NULL;
    double trace = m[0] + m[4] + m[8];
    if (trace >= m[0] && trace >= m[4] && trace >= m[8]) {
        x = m[7] - m[5], y = m[2] - m[6], z = m[3] - m[1], w = 1.0 + trace;
    } else if (m[0] >= m[4] && m[0] >= m[8]) {
        x = 1.0 + 2.0 * m[0] - trace, y = m[1] + m[3], z = m[2] + m[6], w = m[7] - m[5];
    } else if (m[4] >= m[8]) {
        x = m[1] + m[3], y = 1.0 + 2.0 * m[4] - trace, z = m[5] + m[7], w = m[2] - m[6];
    } else {
        x = m[2] + m[6], y = m[5] + m[7], z = 1.0 + 2.0 * m[8] - trace, w = m[3] - m[1];
    }
    double scale = copysign(1.0 / sqrt(x * x + y * y + z * z + w * w), w);
    x *= scale, y *= scale, z *= scale, w *= scale;
    double sine = sqrt(x * x + y * y + z * z);
    if (sine < tiny)
        scale = w >= 0.0 ? 2.0 : -2.0;
    else
        scale = 2.0 * atan2(copysign(sine, w), fabs(w)) / sine;
    return Py_BuildValue("(ddd)", x * scale, y * scale, z * scale);
}

PyDoc_STRVAR(point_positions_doc,
"point_positions(points)\n--\n\n"
"Positions in the base frame, [x, y, z] each, of points (origin, rotation, twist, offset).");

/* Read the offset, a list, of a point and the arrays of its link that are asked for. */
static int point(PyObject *tuple, double offset[3], double origin[3], double turn[9],
                 double twist[6])
{
    if (!PyTuple_Check(tuple) || PyTuple_GET_SIZE(tuple) != 4) {
        PyErr_SetString(PyExc_ValueError, "a point is (origin, rotation, twist, offset)");
        return 0;
    }
    return floats(PyTuple_GET_ITEM(tuple, 3), offset, 3)
           && (origin == NULL || doubles(PyTuple_GET_ITEM(tuple, 0), origin, 3))
           && (turn == NULL || rotation(PyTuple_GET_ITEM(tuple, 1), turn))
           && (twist == NULL || doubles(PyTuple_GET_ITEM(tuple, 2), twist, 6));
}

static PyObject *point_positions(PyObject *self, PyObject *points)
{
    double p[3], x0[3], m[9], x[3];
    if (!PyList_Check(points)) {
        PyErr_SetString(PyExc_ValueError, "a list of points is needed");
        return NULL;
    }
    Py_ssize_t count = PyList_GET_SIZE(points);
    PyObject *positions = PyList_New(count);
    for (Py_ssize_t i = 0; positions != NULL && i < count; i++) {
        PyObject *position = NULL;
        if (point(PyList_GET_ITEM(points, i), p, x0, m, NULL)) {
            for (int k = 0; k < 3; k++)
                x[k] = x0[k] + m[3 * k] * p[0] + m[3 * k + 1] * p[1] + m[3 * k + 2] * p[2];
            position = list_of(x, 3);
        }
        if (position == NULL) {
            Py_CLEAR(positions);
            break;
        }
        PyList_SET_ITEM(positions, i, position);
    }
    return positions;
}

PyDoc_STRVAR(point_speeds_doc,
"point_speeds(points)\n--\n\n"
"Speeds of points (origin, rotation, twist, offset).");

static PyObject *point_speeds(PyObject *self, PyObject *points)
{
    double p[3], v[6];
    if (!PyList_Check(points)) {
        PyErr_SetString(PyExc_ValueError, "a list of points is needed");
        return NULL;
    }
    Py_ssize_t count = PyList_GET_SIZE(points);
    PyObject *speeds = PyList_New(count);
    for (Py_ssize_t i = 0; speeds != NULL && i < count; i++) {
        PyObject *speed = NULL;
        if (point(PyList_GET_ITEM(points, i), p, NULL, NULL, v)) {
            double x = v[0] + (v[4] * p[2] - v[5] * p[1]);
            double y = v[1] + (v[5] * p[0] - v[3] * p[2]);
            double z = v[2] + (v[3] * p[1] - v[4] * p[0]);
            speed = PyFloat_FromDouble(sqrt(x * x + y * y + z * z));
        }
        if (speed == NULL) {
            Py_CLEAR(speeds);
            break;
        }
        PyList_SET_ITEM(speeds, i, speed);
    }
    return speeds;
}

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, name##_doc}

static PyMethodDef functions[] = {
    FUNCTION(velocity_check), FUNCTION(torque_check),  FUNCTION(within),
    FUNCTION(torque_within),  FUNCTION(joints_within), FUNCTION(rotation_vector),
    {"point_positions", point_positions, METH_O, point_positions_doc},
    {"point_speeds", point_speeds, METH_O, point_speeds_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernel", "Inner loops of the control step.", -1, functions,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    PyObject *made = PyModule_Create(&module);
    /* Raised with every change of a function; compiled.py refuses another one. */
    if (made != NULL && PyModule_AddIntConstant(made, "INTERFACE", 1) < 0)
        Py_CLEAR(made);
    return made;
}
