// A pose by ceres::TinySolver with automatic derivatives, and its covariance.

#include "ceres/tiny_solver.h"

#include "ceres/tiny_solver_autodiff_function.h"
#include "head.h"

using namespace peers;

// Laid out as in src/tiny_solver.rs.
struct Options {
  double arm;
  double function_tolerance;
  double parameter_tolerance;
  double cost_threshold;
  double trust_region_radius;
};

struct Pose {
  double rotation[4];  // x, y, z, w
  double translation[3];
};

struct Answer {
  Pose pose;
  double covariance[36];
  int iterations;
};

namespace {

using Parameters = Eigen::Matrix<double, kParameters, 1>;
using Covariance = Eigen::Matrix<double, kParameters, kParameters>;
using Jacobian = Eigen::Matrix<double, kResiduals, kParameters>;

// Keeps the last Jacobian: TinySolver has one but does not hand it out, and the covariance needs it.
class Recorded {
 public:
  EIGEN_MAKE_ALIGNED_OPERATOR_NEW
  using Scalar = double;
  enum { NUM_RESIDUALS = kResiduals, NUM_PARAMETERS = kParameters };

  explicit Recorded(const Residuals& residuals) : function_(residuals) {}

  bool operator()(const double* parameters, double* residuals, double* jacobian) const {
    const bool done = function_(parameters, residuals, jacobian);
    if (jacobian != nullptr) jacobian_ = Eigen::Map<const Jacobian>(jacobian);
    return done;
  }

  const Jacobian& jacobian() const { return jacobian_; }

 private:
  ceres::TinySolverAutoDiffFunction<Residuals, kResiduals, kParameters> function_;
  mutable Jacobian jacobian_;
};

}  // namespace

extern "C" void tiny_solver(const Cell* cells, const Reading* readings, const Pose* start, const Options* options,
                      Answer* answer) {
  const Eigen::Map<const Eigen::Quaterniond> rotation(start->rotation);
  const Eigen::Map<const Eigen::Vector3d> translation(start->translation);
  const Residuals residuals(cells, readings, rotation.toRotationMatrix(), translation, options->arm);
  const Recorded function(residuals);

  // Without pivots: 4 % faster than the default, and the damped matrix needs none.
  ceres::TinySolver<Recorded, Eigen::LLT<Covariance>> solver;
  solver.options.function_tolerance = options->function_tolerance;
  solver.options.parameter_tolerance = options->parameter_tolerance;
  solver.options.cost_threshold = options->cost_threshold;
  solver.options.initial_trust_region_radius = options->trust_region_radius;
  Parameters x = Parameters::Zero();
  const auto& summary = solver.Solve(function, &x);
  answer->iterations = summary.iterations;

  const Eigen::Vector3d a = 0.5 * x.tail<3>();
  const Eigen::Quaterniond turn(1.0, a.x(), a.y(), a.z());
  Eigen::Map<Eigen::Quaterniond>(answer->pose.rotation) = (turn * rotation).normalized();
  Eigen::Map<Eigen::Vector3d>(answer->pose.translation) = translation + options->arm * x.head<3>();

  const Eigen::LLT<Covariance> factor(function.jacobian().transpose() * function.jacobian());
  // Column by column: Eigen unrolls the solution of one, but not of six at once.
  Covariance inverse;
  for (int i = 0; i < kParameters; ++i) inverse.col(i) = factor.solve(Parameters::Unit(i));
  // From the parameters to metres and radians at the solution: there a change dx of the rotation
  // vector turns by (I + [a]) dx / (1 + a^2).
  Eigen::Matrix3d turned;
  turned << 1.0, -a.z(), a.y(), a.z(), 1.0, -a.x(), -a.y(), a.x(), 1.0;
  turned /= 1.0 + a.squaredNorm();
  Eigen::Map<Covariance> covariance(answer->covariance);
  covariance.topLeftCorner<3, 3>() = (options->arm * options->arm) * inverse.topLeftCorner<3, 3>();
  covariance.topRightCorner<3, 3>() = options->arm * (inverse.topRightCorner<3, 3>() * turned.transpose());
  covariance.bottomLeftCorner<3, 3>() = covariance.topRightCorner<3, 3>().transpose();
  covariance.bottomRightCorner<3, 3>() = turned * inverse.bottomRightCorner<3, 3>() * turned.transpose();
}
