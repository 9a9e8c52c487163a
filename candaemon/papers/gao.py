"""The experiments of Gao et al. 2016: the joint adaptive Kalman filter (JAKF) of a lidar and a radar."""

from __future__ import annotations

from candaemon.papers.experiment import Experiment
from candaemon.papers.gao_drives import FIRST, SECOND, THIRD
from candaemon.papers.gao_sweeps import acceleration_sweep, noise_sweep

_MEASURED = (
    "H is the unit matrix: displacement, velocity and acceleration are measured, with equal variances, at 100 Hz; the "
    "axes are independent, so one is filtered. The filters are told noise of 0.03 (lidar) and 0.1 (radar)."
)
_CONVENTIONAL = "CKF: its gains are filterpy's."
_PROCESS = (
    "Q is constant, as in section 4.2, and 1e-6 times the unit matrix: times G Gᵀ it would let no acceleration change. "
    "The filters begin with the vehicle's first state as stated, and P = 1, which the paper does not give."
)
_WINDOW = (
    "Lost inverses, sums and signs are put back. The window of 30 takes the innovations as they come: corrected ones "
    "would lock the lidar out for good. R is taken as diagonal, and H P Hᵀ in it is that of the fused prediction."
)
_FACTORS = (
    "The rule of 20 times holds for any sensor against the best; the paper watches the lidar alone. With a given R the "
    "fused result does not depend on β."
)
_VARIATIONAL = "'JAKF, variational R' is ours: a variational Bayesian R, forgetting 0.97, in the place of the window."
_DEFAULT = (
    "The default estimator takes position and velocity of both sensors at the nominal noise; it has no use for a "
    "measured acceleration, and nobody tells it of the bursts."
)
_BOUND = (
    "The bound is one centralised filter that is told the true start, the true R of each instant, and Q = 0, as the "
    "acceleration is constant."
)
_REFERENCE = (
    "The column 'bound' is a reference and no strict bound: one centralised filter that is told the true start and R "
    "of each instant, with white jerk of 0.01 (m/s³)²/Hz for the motion, which is in truth a sine."
)
_COMMON = (_MEASURED, _CONVENTIONAL, _PROCESS, _WINDOW, _FACTORS, _VARIATIONAL, _DEFAULT)

_ONE_DRIVE = (
    "'Increased by 0.1 per time span' is read as one drive: 100 samples at each of the 60 variances, after 500 at the "
    "first. The paper prints figures of the JAKF alone."
)
_MANY_DRIVES = (
    "Each acceleration is a drive of its own, 300 samples from the start, of which the filters are told 0.18 m/s². A "
    "constant acceleration fits the model, so that once a filter has converged its size has no influence. Raised "
    "within one drive it would make the joint filter worse than the lidar's own, against Figure 4."
)
_STAND_IN = (
    "The recorded drive is not published: motion and noise are drawn by what the text says, the radar's noise from 0.1 "
    "and the lidar's bursts from 2, which gives the printed error of its CKF in the first drive. Variances are those "
    "of the estimates over all samples: no errors, so that they have neither a default nor a bound."
)
_MANOEUVRE = (
    "With Q = 1e-6 every filter lags behind this acceleration, and an adaptive R takes the lag for noise; 'wider Q' is "
    "a white jerk of 0.01 (m/s³)²/Hz instead. With such noise no Q reaches the printed errors of acceleration."
)
_BURSTS_OF_FIRST = (
    "The lidar suffers from sample 1000 to 1500, 2000 to 3000 (the text also says 2500) and 3500 to 4000 of 5000; "
    "errors count from the 500th, where the paper finds its filters converged."
)
_MOTION_OF_SECOND = (
    "The acceleration is a sine of 0.538 m/s² and 42.5 s, with the printed variances of velocity and acceleration; "
    "from the stated start no motion has that of displacement too. Errors count from the 500th sample."
)
_MOTION_OF_THIRD = (
    "The acceleration is a sine of 0.429 m/s² and 16.4 s, with the printed variances of velocity and acceleration, "
    "which force it to end 13 m to the side: no change of lanes. The printed variance of displacement, 169 m to the "
    "side in 10 s, is a slip. Errors count from the 100th of 1000 samples."
)

EXPERIMENTS = (
    Experiment(
        "004-noise-sweep",
        "Noise of the lidar from 0.03 to 5.93, of the radar 0.1, paper 004 section 4.1, figure 3",
        (*_COMMON, _BOUND, _ONE_DRIVE),
        noise_sweep,
    ),
    Experiment(
        "004-acceleration-sweep",
        "Acceleration of the vehicle from 0.18 to 6.08 m/s², paper 004 section 4.1, figure 4",
        (*_COMMON, _BOUND, _MANY_DRIVES),
        acceleration_sweep,
    ),
    Experiment(
        FIRST.name,
        "First drive: constant acceleration, bursts of noise on the lidar, paper 004 table 3",
        (*_COMMON, _BOUND, _STAND_IN, _BURSTS_OF_FIRST),
        FIRST.run,
    ),
    Experiment(
        SECOND.name,
        "Second drive: varying acceleration, bursts of noise on the lidar, paper 004 table 4",
        (*_COMMON, _REFERENCE, _STAND_IN, _MOTION_OF_SECOND, _MANOEUVRE),
        SECOND.run,
    ),
    Experiment(
        THIRD.name,
        "Third drive: lateral motion, bursts of noise on the lidar, paper 004 table 5",
        (*_COMMON, _REFERENCE, _STAND_IN, _MOTION_OF_THIRD, _MANOEUVRE),
        THIRD.run,
    ),
)
