"""Thresholds that a diagnosis decides by, each with its reason.

They are no settings: they were fixed on simulated and published recordings (numbers in brackets are
decisions in `.github/decisions`), and a diagnosis that could move them would prove nothing. Numbers
of methods stand with their methods.
"""

# ---- When an effect is named [0016, 0017]

# Log evidence: e^12 to one, beside a catalogue of some thousand starts at all places.
NAMED_EVIDENCE = 12.0
# Standard deviations of its amplitudes from nothing: evidence alone can come from the prior.
NAMED_DEVIATIONS = 5.0
# Share of a channel's squared residual that it takes away. Filtered samples hang together, so that
# less counts as certain and is not.
NAMED_SHARE = 0.02
# Less is enough where nominal values would have to leave their tolerances to stand in for it: where
# the log prior that they regain is this share of the evidence.
PRIOR_RELIEF_SHARE = 0.5

# ---- When the rigid model is re-identified [0036]

# One change of masses stands for all where it gains this share of what all free parameters gain
# in recordings left out.
SINGLE_CHANGE_SHARE = 0.9

# ---- How many effects [0036]

# Named at most beside what the set does not give; and where nobody vouches for the nominal masses,
# so that anything may be missing, at most and tried together before all is weighed again.
MAX_EFFECTS = 3
MAX_EFFECTS_FREE, MAX_EFFECTS_PER_ROUND = 12, 3

# ---- When it is confirmed [0019]

# Jackknife deviations of its amplitudes from nothing, over stretches of the recordings.
CONFIRMED_DEVIATIONS = 3.5
# At least, in any case, where nobody vouches for the nominal model [0036].
STRICT_DEVIATIONS = 2.5
# And of the amplitude that is known best by itself.
DETERMINED_DEVIATIONS = 2.0
# Or, where a few seconds hold all there is: most of a channel's residual taken away, and most of
# the evidence kept in runs left out.
LOCAL_EVIDENCE_SHARE = 0.5

# ---- When it may be nothing, all that is known of its deviation counted [0053]

# Deviations from nothing that a finding has at least; and a value that every joint has and the
# nominal model does not give.
FINDING_DEVIATIONS, UNSTATED_DEVIATIONS = 2.0, 1.0
# Share of its channel that it takes away in recordings left out: less is told as 0 %.
FINDING_SHARE = 0.005

# ---- When recordings left out bear it out [0036, 0045]

# Share of its channel's squares that a finding takes away in recordings left out, and share of them
# in which it helps.
MIN_HELD_OUT_SHARE, MIN_HELPED_FOLDS = 0.01, 0.6
# The share where an extended model was started from: what that model left open varies from one part
# of its own recordings to another by nearly as much, and is no change. From the second on it need
# not help in most parts, but in more than one: a stop is reached seldom.
MIN_CHANGE_SHARE, RARE_CHANGE_SHARE = 0.15, 0.5
# Candidates for a change whose shapes are fitted, and those that are tried where the best fails.
MAX_REFINED_CHANGES, MAX_TRIED_CHANGES = 12, 4
# Those are alike that have this share of the evidence of the likeliest.
EQUIVALENT_EVIDENCE_SHARE = 0.5
# One change stands for several where it also leaves at most so many times as much in every channel.
MAX_SINGLE_CHANGE_RATIO = 1.5

# A finding that adds more than this to its channel, over what the nominal model leaves there (root
# mean squares), only balances another.
MAX_CANCELLATION_RATIO = 1.5

# ---- What is a rival [0020]

# Log evidences are too sure where formulas differ from nature: a difference counts over this share
# of the winner's own, which is held between 1 and the second.
TEMPERING_SHARE, MAX_TEMPERING = 0.01, 30.0
# Log odds within which another explanation is a rival: 20 to one.
RIVAL_LOG_ODDS = 3.0
# Log prior odds for every parameter that the data determine: of two that fit alike the plainer.
PARAMETER_LOG_PRICE = 1.0
# Parameters that a change since an extended model was made counts as at most.
MAX_CHANGE_PARAMETERS = 3.0
# A difference counts there over so many times the evidence that what the model left open gives to
# the formula that it favours most.
SUSPECT_EVIDENCE_UNITS = 2.0
# How far from the centre of a body a mass that is added to it typically is [m].
ADDED_MASS_OFFSET = 0.1
# How often a likelier explanation takes the place of what was found before both are dropped.
MAX_EXCHANGES = 3

# ---- What a misfit takes from the odds [0036]

# Residual over noise from which likelihood alone makes nothing certain, and the odds that what is
# open in a channel gives to an unknown cause of both.
MISFIT_RATIO, MISFIT_ODDS = 2.0, 0.5
# And what a finding gives to it that one half of the recordings does not bear out for the other.
UNREPEATED_ODDS = 0.5

# Residual over noise of a fit with swinging links from which one in balance is tried as well [0037]
MAX_VIBRATION_MISFIT = 1.5

# How often a search is made anew without times in which something touched the arm: what it had
# explained away may show another.
MAX_CONTACT_ROUNDS = 2

# A fit is taken about itself until links move by less than this, rms over noise, or amplitudes by
# less than so many of their standard deviations, so many times at most [0037]
LINEARISATION_TOLERANCE, LINEARISATION_DEVIATIONS, MAX_LINEARISATIONS = 0.02, 0.1, 4

# ---- When something is outside the catalogue [0023]

# Residual over noise from which a channel counts as not explained, beyond what formulas that differ
# a little leave.
UNEXPLAINED_RATIO = 1.3
# Findings that take away less than this share of a channel's excess do not explain it.
EXPLAINED_SHARE = 0.6
# Beside findings that explain the most of it, what is left below this ratio is passed over.
PASSED_OVER_RATIO = 5.0
# From this ratio on nothing counts as named, whatever was found, if as much is left of what the
# nominal model leaves: the most is open.
OPEN_RATIO, OPEN_SHARE = 10.0, 0.5
# Without findings, a remainder is something from this ratio on, or if flexible functions of the
# signals predict this share of it in runs left out; else the noise is larger than stated.
REMAINDER_RATIO, REMAINDER_SHARE = 1.8, 0.25
# Nearer to the noise, from the first ratio on, if what it depends on takes away the second of its
# square in runs left out.
FAINT_RATIO, FAINT_SHARE = 1.05, 0.1

# ---- When torque has bursts [0024, 0070]

# Residual over its usual size, and over noise where they lie. Dry friction at reversals came to at
# most 1.095 and 1.7 in 150 recordings with nothing missing; compared in one band 22 sets of seven
# robots come to at most 1.10 and 1.73, most to 1.02 and 1.2 [0070].
BURSTING_RATIO, BURST_RATIO = 1.10, 1.8
