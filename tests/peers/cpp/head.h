// The residuals of a head of six cells as a function of six parameters, for ceres' solvers.

#pragma once

#include "Eigen/Dense"
#include "cell.h"

namespace peers {

constexpr int kCells = 6;
constexpr int kResiduals = 2 * kCells;
constexpr int kParameters = 6;

// What was measured of a cell, and its weight: the inverse Cholesky factor of the covariance of the
// two currents. Laid out as in src/weights.rs.
struct Reading {
  double currents[2];
  double whiten_first, whiten_mixed, whiten_second;
};

// Whitened residuals near a start pose.
//
// Parameters: translation from the start in units of `arm`, then a rotation vector (Cayley's map,
// which equals the exponential to third order and needs no trigonometry), both in the base frame.
class Residuals {
 public:
  Residuals(const Cell* cells, const Reading* readings, const Eigen::Matrix3d& rotation,
            const Eigen::Vector3d& translation, double arm)
      : cells_(cells), readings_(readings), arm_(arm) {
    for (int i = 0; i < kCells; ++i) {
      const Cell& cell = cells[i];
      Start& start = starts_[i];
      Eigen::Map<Eigen::Vector3d>(start.arm) = rotation * Eigen::Map<const Eigen::Vector3d>(cell.emitter);
      Eigen::Map<Eigen::Vector3d>(start.axis) = rotation * Eigen::Map<const Eigen::Vector3d>(cell.emitter_axis);
      Eigen::Map<Eigen::Vector3d>(start.offset) = translation - Eigen::Map<const Eigen::Vector3d>(cell.centre);
    }
  }

  // Left to itself the compiler keeps some operations of Jets as functions that pass their results
  // through memory: a fifth slower.
  template <typename T>
  [[gnu::flatten]] bool operator()(const T* x, T* residuals) const {
    // R = I + f ([a] + [a]^2) with a half the rotation vector and f = 2 / (1 + a^2).
    const T ax = 0.5 * x[3], ay = 0.5 * x[4], az = 0.5 * x[5];
    const T xx = ax * ax, yy = ay * ay, zz = az * az;
    const T f = 2.0 / (1.0 + xx + yy + zz);
    const T xy = f * (ax * ay), xz = f * (ax * az), yz = f * (ay * az);
    const T fx = f * ax, fy = f * ay, fz = f * az;
    const Vector<T> rows[3] = {{1.0 - f * (yy + zz), xy - fz, xz + fy},
                               {xy + fz, 1.0 - f * (xx + zz), yz - fx},
                               {xz - fy, yz + fx, 1.0 - f * (xx + yy)}};
    const T shift[3] = {x[0] * arm_, x[1] * arm_, x[2] * arm_};
    for (int i = 0; i < kCells; ++i) {
      const Cell& cell = cells_[i];
      const Start& start = starts_[i];
      const Vector<T> position = {dot(start.arm, rows[0]) + shift[0] + start.offset[0],
                                  dot(start.arm, rows[1]) + shift[1] + start.offset[1],
                                  dot(start.arm, rows[2]) + shift[2] + start.offset[2]};
      const Vector<T> axis = {dot(start.axis, rows[0]), dot(start.axis, rows[1]), dot(start.axis, rows[2])};
      const Vector<T> e = {dot(cell.axes[0], position), dot(cell.axes[1], position), dot(cell.axes[2], position)};
      const Vector<T> u = {dot(cell.axes[0], axis), dot(cell.axes[1], axis), dot(cell.axes[2], axis)};
      T first, second;
      if (!currents(cell, e, u, &first, &second)) first = second = T(0.0);
      const Reading& reading = readings_[i];
      first -= reading.currents[0];
      second -= reading.currents[1];
      residuals[2 * i] = first * reading.whiten_first;
      residuals[2 * i + 1] = first * reading.whiten_mixed + second * reading.whiten_second;
    }
    return true;
  }

 private:
  // What of a cell does not change during one solve.
  struct Start {
    double arm[3], axis[3];  // emitter and its axis turned by the start's rotation
    double offset[3];        // start's translation less the detector's centre
  };

  const Cell* cells_;
  const Reading* readings_;
  double arm_;
  Start starts_[kCells];
};

}  // namespace peers
