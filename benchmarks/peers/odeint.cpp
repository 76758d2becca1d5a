// Boost.odeint's dense-output Dormand-Prince 5(4): contacts bisected on the dense output, or tanh.
#include <array>
#include <boost/numeric/odeint.hpp>
#include <cmath>
using namespace boost::numeric::odeint;
using State = std::array<double, 2>;

struct Scene {
    double stiffness, damping, cubic, forcing, omega, contact, j_1, j_2, epsilon;
    double active, wall;  // of the frozen contact mode

    double force(double x) const {
        if (epsilon == 0.0) return active * (x - wall);
        const double below = x + j_1, above = x - j_2;
        return 0.5 * contact * ((1 - std::tanh(epsilon * below)) * below + (1 + std::tanh(epsilon * above)) * above);
    }
    void operator()(const State &y, State &d, double t) const {
        d[0] = y[1];
        d[1] = forcing * std::cos(omega * t) - damping * y[1] - (stiffness + cubic * y[0] * y[0]) * y[0] - force(y[0]);
    }
};

// p: the first nine fields of Scene. Ends with (x, v) at t_end in `end`; returns the steps made.
extern "C" long integrate(const double *p, double t_end, double rtol, double atol, double *end) {
    Scene s{p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], 0.0, 0.0};
    auto solver = make_dense_output(atol, rtol, runge_kutta_dopri5<State>());
    State y{0.0, 0.0};
    int mode = 0;
    long n_steps = 0;
    solver.initialize(y, 0.0, 1e-4);
    while (true) {
        auto [a, b] = solver.do_step(std::cref(s));
        ++n_steps;
        y = solver.current_state();
        double wall = 0.0;
        bool crossed = false;
        if (s.epsilon == 0.0) {
            if (mode >= 0 && (mode == 0) == (y[0] > s.j_2) && (mode == 0 || y[0] < s.j_2)) wall = s.j_2, crossed = true;
            if (!crossed && mode <= 0 && (mode == 0) == (y[0] < -s.j_1) && (mode == 0 || y[0] > -s.j_1)) wall = -s.j_1, crossed = true;
        }
        if (crossed) {
            double low = a, high = b;
            const double side = y[0] > wall ? 1 : -1;
            for (int i = 0; i < 200 && high - low > 4e-16 * std::max(1.0, high); ++i) {
                const double middle = 0.5 * (low + high);
                if (middle <= low || middle >= high) break;
                solver.calc_state(middle, y);
                ((y[0] - wall) * side > 0 ? high : low) = middle;
            }
            b = high;
            solver.calc_state(b, y);
        }
        if (b >= t_end) break;
        if (crossed) {
            y[0] = wall;
            mode = mode ? 0 : (y[1] > 0 ? 1 : -1);
            s.active = mode ? s.contact : 0.0;
            s.wall = mode > 0 ? s.j_2 : -s.j_1;
            solver.initialize(y, b, std::max(1e-7, 0.3 * solver.current_time_step()));
        }
    }
    solver.calc_state(t_end, y);
    end[0] = y[0], end[1] = y[1];
    return n_steps;
}
