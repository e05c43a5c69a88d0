// Equations (1) to (5) of De La Cruz, Gosselin, Bachta, Morel 2018 for a thin slit parallel to its
// detector, written for ceres' Jet and for double alike.
//
// Same definitions and the same forms that do not cancel as in model/src/paper.rs: the spot is the
// slit's projection, clipped by the detector, seen as one plate; its solid angle is
// 4 atan(ab / sqrt(1 + a^2 + b^2)) with a, b the tangents of the half angles of its mid-lines.
// SI units.

#pragma once

#include <cmath>

#include "ceres/jet.h"

namespace peers {

// One cell. Laid out as in src/tiny_solver.rs.
struct Cell {
  double axes[3][3];  // x, y, z of the cell frame, in the base frame
  double centre[3];   // of the detector, base frame
  double slit_height;
  double slit_low[2], slit_high[2];  // in x and y of the cell frame
  double detector_half[2];
  double emitter[3], emitter_axis[3];  // tool frame
  double gain;                         // responsivity times intensity on the axis, A/sr
  double exponent;                     // relative intensity is the cosine to this power
};

template <typename T>
struct Vector {
  T x, y, z;
};

using Vector3 = Vector<double>;

template <typename T>
inline T dot(const double a[3], const Vector<T>& b) {
  return b.x * a[0] + b.y * a[1] + b.z * a[2];
}

// x to a constant power. ceres' own for Jets calls std::pow twice.
inline double power(double x, double exponent) { return std::pow(x, exponent); }

template <int N>
inline ceres::Jet<double, N> power(const ceres::Jet<double, N>& x, double exponent) {
  const double value = std::pow(x.a, exponent);
  return ceres::Jet<double, N>(value, (exponent * value / x.a) * x.v);
}

// One extent of the spot, relative to the emitter's foot point.
template <typename T>
struct Extent {
  T low, high, middle, length;
};

// The slit's projection with magnification k, clipped by the detector; false if nothing is left.
template <typename T>
inline bool project(double low, double high, double half, const T& e, const T& k, Extent<T>* extent) {
  const T from = (low - e) * k, to = (high - e) * k;
  const T first = -half - e, last = half - e;
  const bool whole = from >= first && to <= last;
  if (whole) {
    extent->low = from;
    extent->high = to;
    // The slit's own length survives where the difference would cancel.
    extent->length = k * (high - low);
  } else {
    extent->low = from >= first ? from : first;
    extent->high = to <= last ? to : last;
    extent->length = extent->high - extent->low;
  }
  extent->middle = 0.5 * (extent->low + extent->high);
  return extent->length > 0.0;
}

// The two currents of a cell with its emitter at `e` and its axis along `u`, both in the cell
// frame. False without light.
template <typename T>
inline bool currents(const Cell& cell, const Vector<T>& e, const Vector<T>& u, T* first, T* second) {
  using std::atan;
  using std::sqrt;
  if (e.z <= cell.slit_height) return false;
  const T k = e.z / (e.z - cell.slit_height);
  Extent<T> x, y;
  if (!project(cell.slit_low[0], cell.slit_high[0], cell.detector_half[0], e.x, k, &x)) return false;
  if (!project(cell.slit_low[1], cell.slit_high[1], cell.detector_half[1], e.y, k, &y)) return false;

  // Rays to the four edge mid-points: their lengths serve the central axis and the half angles.
  const T h2 = e.z * e.z;
  const T across_x = h2 + y.middle * y.middle;
  const T across_y = h2 + x.middle * x.middle;
  const T x_low = sqrt(x.low * x.low + across_x), x_high = sqrt(x.high * x.high + across_x);
  const T y_low = sqrt(y.low * y.low + across_y), y_high = sqrt(y.high * y.high + across_y);

  // Central axis: the sum of the rays' unit vectors.
  const T inverse_x_low = 1.0 / x_low, inverse_x_high = 1.0 / x_high;
  const T inverse_y_low = 1.0 / y_low, inverse_y_high = 1.0 / y_high;
  const T per_x = inverse_x_low + inverse_x_high, per_y = inverse_y_low + inverse_y_high;
  const T sum_x = x.low * inverse_x_low + x.high * inverse_x_high + x.middle * per_y;
  const T sum_y = y.low * inverse_y_low + y.high * inverse_y_high + y.middle * per_x;
  const T sum_z = -e.z * (per_x + per_y);
  const T cosine = (u.x * sum_x + u.y * sum_y + u.z * sum_z) / sqrt(sum_x * sum_x + sum_y * sum_y + sum_z * sum_z);
  if (cosine <= 0.0) return false;

  // Equation (3).
  const T a = x.length * sqrt(across_x) / (x_low * x_high + x.low * x.high + across_x);
  const T b = y.length * sqrt(across_y) / (y_low * y_high + y.low * y.high + across_y);
  const T solid_angle = 4.0 * atan(a * b / sqrt(1.0 + a * a + b * b));

  // Equations (5) and (1).
  const T total = solid_angle * power(cosine, cell.exponent) * cell.gain;
  const T half = 0.5 * total;
  const T imbalance = total * (e.x + x.middle) * (0.5 / cell.detector_half[0]);
  *first = half - imbalance;
  *second = half + imbalance;
  return true;
}

}  // namespace peers
