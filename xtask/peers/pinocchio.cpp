// Pinocchio as a peer of `cargo xtask peers`: its constrained dynamics (proximal, loop closed by a point constraint), integrated by
// Boost.Odeint.
//
//     peer-pinocchio METHOD STEP_OR_TOLERANCE KP KD ANGLE ANGLE ANGLE ANGLE
//
// METHOD `rk4` (fixed step, s) or `rkf78` (error-controlled, Runge-Kutta-Fehlberg 7(8)); KP, KD are Baumgarte's gains, 1/s^2, 1/s.
// Reads times, one per line; answers each with the processor time so far, s, four angles and four rates.
#include <algorithm>
#include <array>
#include <boost/numeric/odeint.hpp>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <string>
#include <vector>

namespace odeint = boost::numeric::odeint;
namespace pin = pinocchio;

constexpr double LENGTH = 0.21, COM = 0.105, MASS = 0.017, INERTIA = 6.23e-5, BASE = 0.42, GRAVITY = 9.81;
// Four joint angles and their rates: left leg, right leg, each starting at the motor.
using State = std::array<double, 8>;

class FiveBar {
public:
    FiveBar(double kp, double kd) {
        const pin::Inertia link(MASS, Eigen::Vector3d(COM, 0, 0), INERTIA * Eigen::Matrix3d::Identity());
        const pin::SE3 end(Eigen::Matrix3d::Identity(), Eigen::Vector3d(LENGTH, 0, 0));
        std::array<pin::JointIndex, 2> distal;
        for (int leg = 0; leg < 2; ++leg) {
            const pin::SE3 motor(Eigen::Matrix3d::Identity(), Eigen::Vector3d(leg * BASE, 0, 0));
            const std::string name = leg ? "right" : "left";
            const auto proximal = model_.addJoint(0, pin::JointModelRZ(), motor, name + " proximal");
            model_.appendBodyToJoint(proximal, link);
            distal[leg] = model_.addJoint(proximal, pin::JointModelRZ(), end, name + " distal");
            model_.appendBodyToJoint(distal[leg], link);
        }
        model_.gravity.linear() = Eigen::Vector3d(0, -GRAVITY, 0);
        loop_.emplace_back(pin::CONTACT_3D, model_, distal[0], end, distal[1], end, pin::LOCAL);
        loop_[0].m_baumgarte_parameters = {kp, kd};
        loop_data_.emplace_back(loop_[0].createData());
        data_ = pin::Data(model_);
        pin::initConstraintDynamics(model_, data_, loop_, loop_data_);
        tau_ = q_ = v_ = Eigen::VectorXd::Zero(model_.nv);
    }

    void operator()(const State& y, State& dydt, double) {
        std::copy(y.begin(), y.begin() + 4, q_.data());
        std::copy(y.begin() + 4, y.end(), v_.data());
        const auto& a = pin::constraintDynamics(model_, data_, q_, v_, tau_, loop_, loop_data_, proximal_);
        std::copy(y.begin() + 4, y.end(), dydt.begin());
        std::copy(a.data(), a.data() + 4, dydt.begin() + 4);
    }

private:
    pin::Model model_;
    pin::Data data_;
    std::vector<pin::RigidConstraintModel> loop_;
    std::vector<pin::RigidConstraintData> loop_data_;
    // The third direction of the point constraint is never violated and has no inertia, so mu regularises it. mu is so small compared
    // with the other directions (1/mass, some 50 1/kg) that one iteration suffices.
    pin::ProximalSettings proximal_{1e-14, 1e-12, 1};
    Eigen::VectorXd q_, v_, tau_;
};

static double processor_time() {
    timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char** argv) {
    if (argc != 9) return std::fprintf(stderr, "eight arguments are needed\n"), 2;
    const std::string method = argv[1];
    const double knob = std::atof(argv[2]);
    FiveBar five_bar(std::atof(argv[3]), std::atof(argv[4]));
    auto system = [&](const State& y, State& dydt, double t) { five_bar(y, dydt, t); };
    const double a = std::atof(argv[5]), b = std::atof(argv[6]), c = std::atof(argv[7]), d = std::atof(argv[8]);
    State y{a, b - a, d, c - d};
    odeint::runge_kutta4<State> rk4;
    auto rkf78 = odeint::make_controlled(knob, knob, odeint::runge_kutta_fehlberg78<State>());
    double now = 0, step = 1e-4, spent = 0, until;
    while (std::scanf("%lf", &until) == 1) {
        const double clock = processor_time();
        if (method == "rk4") {
            const long steps = std::lround((until - now) / knob);
            now = odeint::integrate_n_steps(rk4, system, y, now, knob, steps);
        } else {
            // Like odeint's integrate_adaptive, but keeps the step length between calls.
            while (until - now > 1e-12) {
                double tried = std::min(step, until - now);
                const bool cut = tried < step;
                if (rkf78.try_step(system, y, now, tried) != odeint::success || !cut) step = tried;
                if (!(step > 1e-14)) return std::fprintf(stderr, "the step became too small\n"), 1;
            }
        }
        spent += processor_time() - clock;
        const double out[] = {y[0], y[0] + y[1], y[2] + y[3], y[2], y[4], y[4] + y[5], y[6] + y[7], y[6]};
        std::printf("%.17g", spent);
        for (double x : out) std::printf(" %.17g", x);
        std::puts("");
        std::fflush(stdout);
    }
}
