"""Decision thresholds of a diagnosis, each with its reason.

They are no settings: they were fixed on simulated and published recordings (numbers in brackets are
decisions in `.github/docs/decisions`). Parameters of one method are defined beside that method.
"""

# ---- Naming an effect [0016, 0017]

# Log evidence: odds of e^12 to one, for a catalogue of some thousand initial shapes at all places.
NAMED_EVIDENCE = 12.0
# Standard deviations from zero of an amplitude that distinguishes an effect from simpler ones.
NAMED_DEVIATIONS = 5.0
# Share that it removes of a channel's squared residual and of what the effects that it resembles
# explain there. Filtered samples are correlated and laws are inexact, so that the significance of a
# smaller share is overestimated.
NAMED_SHARE = 0.02
# A smaller share suffices if nominal values would otherwise leave their tolerances: if the log
# prior that they regain is this share of the evidence.
PRIOR_RELIEF_SHARE = 0.5

# An effect acts in a channel or part of the recordings if its squares there are this share of the
# largest ones.
MIN_ACTIVE_SHARE = 0.05

# Probability from which a finding is named, and from which it counts as found.
NAMED_PROBABILITY, FOUND_PROBABILITY = 0.5, 0.95

# ---- Re-identification of the rigid model [0036]

# A single change of masses replaces all free parameters if it gains this share of their log
# predictive density in recordings left out.
SINGLE_CHANGE_SHARE = 0.9

# ---- Number of effects [0036]

# Maximum number of findings, values that the set does not state apart.
MAX_EFFECTS = 3
# The same without stated tolerances of masses, where many effects may be missing; and the number
# that is added per round before all are compared again.
MAX_EFFECTS_FREE, MAX_EFFECTS_PER_ROUND = 12, 3

# ---- Laws beyond the catalogue

# Deviations from zero that determine the function of a law.
CONFIRMED_DEVIATIONS = 3.5

# ---- Findings that may be zero, all known deviations counted [0053]

# Least deviations from zero of a finding; and of a value that every joint has and the nominal
# model does not state.
FINDING_DEVIATIONS, UNSTATED_DEVIATIONS = 2.0, 1.0

# ---- Support by recordings left out [0036, 0045]

# Least share of a channel's squares that a finding removes there.
MIN_HELD_OUT_SHARE = 0.01
# Least share where the diagnosis starts from an extended model, whose open residual varies between
# parts of its own recordings by nearly as much.
MIN_CHANGE_SHARE = 0.15
# From this share on the gain may be that of a single stretch: a stop is seldom reached, a drive
# seldom at its limit.
RARE_SHARE = 0.5
# Candidates for a change whose shapes are fitted, and those that are tried if the best fails.
MAX_REFINED_CHANGES, MAX_TRIED_CHANGES = 12, 4
# Candidates with this share of the evidence of the likeliest are equivalent.
EQUIVALENT_EVIDENCE_SHARE = 0.5
# A single change replaces several if its residual is at most this ratio of theirs in every channel.
MAX_SINGLE_CHANGE_RATIO = 1.5

# Contribution of a finding to its channel over the residual of the nominal model (root mean
# squares); a larger one only cancels another finding.
MAX_CANCELLATION_RATIO = 1.5

# ---- Rivals [0020]

# Log evidences are overestimated if formulas differ from nature: differences are divided by this
# share of the winner's evidence, clipped to 1 and the second value.
TEMPERING_SHARE, MAX_TEMPERING = 0.01, 30.0
# Log odds within which another explanation is a rival: 20 to one.
RIVAL_LOG_ODDS = 3.0
# Log prior odds per parameter that the data determine: prefers the simpler of two equal fits.
PARAMETER_LOG_PRICE = 1.0
# Upper limit of the parameters counted for a change since an extended model: a changed body is one
# event with up to ten parameters.
MAX_CHANGE_PARAMETERS = 3.0
# Evidence differences of changes are divided by this multiple of the evidence that the open
# residual of the model gives to its likeliest suspect.
SUSPECT_EVIDENCE_UNITS = 2.0
# Typical distance of an added mass from the centre of the body that carries it [m].
ADDED_MASS_OFFSET = 0.1
# Rounds of exchanges for likelier rivals and of confirmation.
MAX_EXCHANGES = 3

# Normalised residual of a fit with vibration from which a quasi-static one is tried as well [0037].
MAX_VIBRATION_MISFIT = 1.5

# Repetitions of the search without contact intervals: explained contacts can hide others.
MAX_CONTACT_ROUNDS = 2

# A fit is linearised again until link angles move by less than the first value (root mean square
# over noise) or amplitudes by less than the second (of their standard deviation) [0037].
LINEARISATION_TOLERANCE, LINEARISATION_DEVIATIONS, MAX_LINEARISATIONS = 0.02, 0.1, 4

# ---- Effects outside the catalogue [0023]

# Normalised residual from which a channel is unexplained; less comes from inexact formulas.
UNEXPLAINED_RATIO = 1.3
# Share of a channel's excess that findings must remove to explain it.
EXPLAINED_SHARE = 0.6
# Beside findings that explain most of it, a residual below this ratio is ignored.
PASSED_OVER_RATIO = 5.0
# From this ratio on the verdict is not "named" if the residual is the second value of that of the
# nominal model.
OPEN_RATIO, OPEN_SHARE = 10.0, 0.5
# Without findings, a residual is significant from this ratio on, or if flexible functions of the
# signals predict this share of it in runs left out; else the noise exceeds the stated one.
REMAINDER_RATIO, REMAINDER_SHARE = 1.8, 0.25
# From this ratio on a channel near the noise is searched for a law, and from this share of the
# residual's excess on a dependence on signals is told.
FAINT_RATIO, FAINT_SHARE = 1.05, 0.1

# ---- Torque bursts [0024, 0070]

# Residual over its usual size, and over the noise at the bursts. Dry friction at reversals came to
# at most 1.095 and 1.7 in 150 recordings without missing effects; 22 sets of seven robots compared
# in one band to at most 1.10 and 1.73, most to 1.02 and 1.2 [0070].
BURSTING_RATIO, BURST_RATIO = 1.10, 1.8
