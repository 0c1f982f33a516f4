"""The published formulas for odometry drift, corrected.

driftplan predicts with the error-moment algebra (`driftplan.model.moments`). This package holds the closed forms of the
papers, for readers who come from them: same letters, same propositions, each function citing paper and equation. The
tests check every one of them against the algebra and against Monte Carlo, and show that the printed variant fails.

Sources
-------
[O]  "The unbounded-drift paper": Propositions 1 and 2, Tables I and II.                         `unbounded_drift`
[K]  J. Knuth, P. Barooah, "Error growth in position estimation from noisy relative pose
     measurements", Robotics and Autonomous Systems, 2013: Theorems 1 to 3, Section 6.
                                          `knuth_barooah`, `estimators`, `relative_pose`
[M]  J. M. Mirats Tur, J. L. Gordillo, C. Albores, "A closed-form expression for the
     uncertainty in odometry position estimate of an autonomous vehicle", IEEE Transactions
     on Robotics, 2005, and its erratum.                                                         `ackermann`
[L]  D. Lerro, Y. Bar-Shalom, "Tracking with debiased consistent converted measurements
     versus EKF", IEEE Transactions on Aerospace and Electronic Systems 29(3), 1993,
     pp. 1015-1022, doi:10.1109/7.220948: one step of Proposition 2.

What was wrong in print, and the evidence for each: the guide's page on misprints, `examples/guide/misprints.md`.
"""

from .ackermann import AckermannDrift as AckermannDrift
from .ackermann import ackermann_drift as ackermann_drift
from .ackermann import ackermann_step as ackermann_step
from .estimators import Correction as Correction
from .estimators import Crossovers as Crossovers
from .estimators import bias_reduced_cov as bias_reduced_cov
from .estimators import bias_reduction as bias_reduction
from .estimators import corrected as corrected
from .estimators import crossovers as crossovers
from .estimators import de_meaning as de_meaning
from .estimators import estimate_positions as estimate_positions
from .knuth_barooah import MeanNoise as MeanNoise
from .knuth_barooah import Theorem1 as Theorem1
from .knuth_barooah import Theorem2 as Theorem2
from .knuth_barooah import Theorem3 as Theorem3
from .knuth_barooah import second_moment_lower_bound as second_moment_lower_bound
from .knuth_barooah import theorem_1 as theorem_1
from .knuth_barooah import theorem_2 as theorem_2
from .knuth_barooah import theorem_3 as theorem_3
from .relative_pose import StepNoise as StepNoise
from .relative_pose import dead_reckoning as dead_reckoning
from .relative_pose import step_moments as step_moments
from .unbounded_drift import Proposition1 as Proposition1
from .unbounded_drift import Proposition2 as Proposition2
from .unbounded_drift import Table as Table
from .unbounded_drift import proposition_1 as proposition_1
from .unbounded_drift import proposition_2 as proposition_2
