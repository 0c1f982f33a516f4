"""The published formulas for odometry drift, corrected; and the list of what was corrected.

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

Misprints
---------
Read from the papers as published ([O] from a text extraction); "z" is (Monte Carlo - formula)/standard error, x is
E R̃, and the other letters are those of the modules named above.

[O] 1. Table I, A: printed ½cos²T (e^(-2iδ_θ²) + 1); correct ½cos²T (1 - e^(-2iδ_θ²)).
       Evidence: z = -3094 against -0.1 in 10⁶ drives; D, its mirror image, is printed right.
[O] 2. Table I, C and F: printed without δ_d²; correct times δ_d².
       Evidence: z beyond -60 000 against 0.3 and 2.1. B, D and E are right as printed.
[O] 3. Table II, A1: printed ½(1 + e^(-2i…))[…cos²…]; correct ½(1 - e^(-2iδ_θ²)). Inherits 1.
       Evidence: equals Table I averaged over the true headings, to 10⁻¹⁴; z = -521 for A1 + B1 + C1 as printed.
[O] 4. Table II, D1: printed {…}(1 - e^(-2i…)) + ½(½e^(-2i…) + 3/2 - 2e^(-½i…))[…]: the ½ is on the wrong term;
       correct ½(1 - g)S + (½g + 3/2 - 2h)K. Evidence: as 3, z = -550 for D1 + E1 + F1 as printed.
[O] 5. Table II, A1 and D1: printed (d^m)²; correct (d^m)² + δ_d². C1 and F1: printed without δ_d²; correct times δ_d².
       B1 and E1 need no such term. "e^(-2iδ_θ2)" means e^(-2iδ_θ²). Evidence: as 3.
[O] 6. Equation (6) announces the average E[var | measurements]; the formula of Proposition 2 gives the total variance
       of the error given the measurements, which is larger by the spread of the bias over the true paths.
       Evidence: for one step [L] gives 0.360926 where the formula gives 0.361604.
[O] 7. Section III-B, second line of x_n^m: printed [Σd̄ + Σd̃]·[sin …]; correct Σ(d̄_i + d̃_i)[sin …].
[O] 8. Section V ranks paths by the norm of the bias |E e|, which is no cost: a detour can cancel it while the error
       grows. Evidence: 10 m straight on against 17.07 m and 7.07 m back, heading variance 10⁻³ rad²/m: bias 0.0250 m
       against 0.0002 m, rms 0.577 m against 0.754 m.
    Not a misprint, but easily misread: the mean of Proposition 2 is that of fresh measurements of the unknown path. The
       posterior mean of the error already made has the opposite sign at first order
       (`Proposition2.measured_path_bias`).

[K] 1. Proof of Theorem 2, E[fᵀf]: printed (I-x)⁻²(I + 2(n-2)x - 2(n-1)x² + 2xⁿ⁺¹); correct (I-x)⁻²(nI - 2x - nx² +
       2xⁿ⁺¹). So ψ lacks rᵀr, and ω has I - 4x + 2x² + 2xⁿ⁺¹ instead of -2x + 2xⁿ⁺¹.
[K] 2. E[fᵀg]: printed Σ bᵀxᵏr; correct Σ (n-k) bᵀxᵏr. So ψ lacks 2bᵀ(I-x)⁻¹r, and ω has bᵀ(I-x)⁻¹(I-xⁿ)r instead of
       -2bᵀ(I-x)⁻²x(I-xⁿ)r.
[K] 3. The factor 2 of 2E[fᵀg] is dropped: printed (2b + r)ᵀ(I-x)⁻¹ρ in ψ and -rᵀ(I-x)⁻²(I-xⁿ)ρ in ω; correct
       2(b + r)ᵀ(I-x)⁻¹ρ and -2rᵀ(I-x)⁻²(I-xⁿ)ρ.
       Evidence for 1 to 3: the printed variance is negative for n = 1, and 3.98·10⁷ m² instead of 1.44·10⁷ m² on the
       straight line of Section 4.2.
[K] 4. Theorem 3, w(j): printed ρ_i; correct ρ_{i+1}. Rotation errors must have one mean, which Assumption 1 does not
       list. (33): sums to n; correct n - 1. "0 <= m < p" means 1 <= m <= p. (34): E[t] means E[t̂], ω(p) means w(p).
       Evidence: round a hexagon of 1 m with biases of about 0.3 m, other at every step, the printed bias is off by
       0.4 m after 6 steps and 1.7 m after 23.
[K] 5. (29): the product is printed from k and i-1 to j; correct from i+1 to j. Proof of Lemma 1: printed
       α₀ = τ² + τb + τρ; correct τ² + τb + τρ/γ + bρ/γ. (10) says >= where the proof needs >; it is not needed at
       all, see `second_moment_lower_bound`. Assumption 1 bounds Tr P_k, the text says eigenvalues.
[K] 6. Constants of Section 4: 1 - c = 1.2873·10⁻⁵ is printed, λ = 3.6·10⁻³ gives 1.29598·10⁻⁵. Tr P = 1.2479·10⁻⁴ is
       printed, the noise stated gives 2.0838·10⁻⁴ (1.2291·10⁻⁴ without its distance part). γ = 0.9997 is printed for
       the von Mises-Fisher law with κ = 10⁴, ‖E R̃‖ is 0.9996000. The mean rotation 6.8·10⁻⁵ is in rad, not m.
       b = -0.6842·10⁻³ m is right.
[K]    "Distance travelled is immaterial for the variance" is not so: 100, 1000, 10 000 steps of 1 m round a square with
       0.05 rad noise give 0.236, 1.709, 13.0 m², turning in place gives none.

[M] 1. The erratum writes tan(φ + ε) - tan φ as sec²φ tan ε; correct sec²φ tan ε/(1 - tan φ tan ε). The car's mean turn
       is lost. Evidence: 100 steps of 0.5 m at φ = 0.5 with 0.1 rad noise: bias 0.172 m instead of 0.739 m.
[M] 2. The covariance of P_{t-1} and ΔP_t is left out. Evidence: straight on, the variance is 68 times too small after
       200 steps of 0.5 m with 0.01 m and 0.01 rad noise; for heading noise alone (2n + 1)/3 times after n steps.
    A warning besides: the distance error enters both turn and move. To take the two errors of a step as independent
       would make E|e|² 3.29 m² instead of 1.26 m² (φ = 0.3, σ_d = 0.1 m, 100 steps).
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
