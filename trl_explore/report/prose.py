"""The sentences of the report: question, method, fairness, provenance. HTML, already escaped."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from trl_explore.report.evidence import Evidence
from trl_explore.report.groups import Group
from trl_explore.report.labels import strategy_label

STRATEGIES = {
    "random": "every action is drawn uniformly; nothing that was learned is used",
    "argmax": "always the action that the policy prefers; never explores",
    "epsilon_greedy": "with probability ε a random action, else the preferred one",
    "decaying_epsilon_greedy": "the same, with an ε that shrinks in every iteration",
    "softmax": "actions are drawn with the probabilities that the policy gives them",
    "boltzmann": "softmax at a temperature that falls from iteration to iteration",
    "mixture": "the preferred action, softmax and a random action, each with a share",
    "max_boltzmann": "with probability ε an action by softmax, else the preferred one",
    "epsilon_softmax": "with probability ε a random action, else one by softmax",
    "epsilon_z_greedy": "ε-greedy whose random actions are repeated for a random time",
    "vdbe": "ε-greedy with an ε that follows how much the mean score still changes",
    "count_bonus": "softmax that prefers what has been tried less often in a state",
    "parameter_noise": "softmax of a policy whose weights are perturbed once per episode",
    "gaussian": "actions are drawn from the Gaussian that the policy gives",
    "epsilon_uniform": "with probability ε any action of the box, else one by the Gaussian",
    "uniform_action": "any action of the box, drawn uniformly; nothing that was learned is used",
    "mean_action": "always the mean of the policy’s Gaussian; never explores",
    "epsilon_mean": "with probability ε any action of the box, else the mean",
}


def question(evidence: Evidence) -> str:
    """What was asked, and the words that a reader needs."""
    main = evidence.groups[0].group
    environments = dict.fromkeys(part.group.environment for part in evidence.groups)
    others = [name for name in environments if name != main.environment]
    elsewhere = f" (in sections of their own {escape(', '.join(others))})" if others else ""
    names = list(dict.fromkeys(o.strategy for o in evidence.outcomes))
    known = [n for n in STRATEGIES if n in names] + [n for n in names if n not in STRATEGIES]
    factors = [part.group.crossed.of for part in evidence.groups if part.group.crossed is not None]
    names = " or ".join(f"their {name}" for name in dict.fromkeys(factors))
    also = f" and, where it says so, {names}" if names else ""
    items = "".join(
        f"<li><b>{escape(strategy_label(n))}</b>"
        f"{': ' + escape(STRATEGIES[n]) if n in STRATEGIES else ''}</li>"
        for n in known
    )
    return (
        "<p>An agent that learns from reward must also try actions that it does not yet prefer."
        " How it does that is its <b>exploration strategy</b>. What does the choice of it do to"
        " how surely, and how fast, a policy-gradient agent learns?</p>"
        f"<p>Here many independent agents (<b>trials</b>) learned {escape(main.environment)}"
        f"{elsewhere} with REINFORCE, all alike except for their strategy{also}. One"
        f" <b>iteration</b> is {_episodes(evidence)} and the update that follows. A trial has"
        " <b>converged</b>, or passed, when its"
        f" mean score over the last {main.window} episodes exceeds {main.threshold:g}; a trial"
        f" that has not after {main.cap:,} iterations is stopped at this <b>cap</b>. The"
        f" strategies:</p><ul>{items}</ul>"
    )


def _episodes(evidence: Evidence) -> str:
    """Of how many episodes an iteration consists."""
    counts = sorted({int(o.config.get("episodes_per_update", 1)) for o in evidence.outcomes})
    words = ["one episode" if k == 1 else f"{k} episodes" for k in counts]
    return " or ".join(words)


def method(evidence: Evidence) -> str:
    """How every number was made."""
    part = evidence.groups[0]
    level = f"{100 * part.level:g} %"
    return (
        "<p>A trial that was stopped at the cap is right-censored: it is known to need more, not"
        " to need just so many iterations. Hence Kaplan–Meier curves with pointwise log-log"
        " intervals, medians that may be “not reached”, means restricted to the cap, and the"
        " expected number of iterations per success when failed trials are restarted. In frames,"
        " failed trials stay in the count to the end. Pass rates have Wilson intervals, means a"
        f" bootstrap over trials ({part.resamples:,} resamples). All intervals are {level}.</p>"
        "<p>Trial k has the same initial weights, environment and action noise under every"
        " strategy, so that strategies are compared pair by pair: bootstrap interval of the mean"
        " paired difference, sign-flip permutation test, Holm’s correction over all pairs of a"
        " table; two configurations are told apart only where interval and corrected test both"
        " exclude zero. The log-rank test, which ignores the pairs, stands beside it as a second"
        " opinion. “Variance kept by pairing” below 1 says that pairing helped. Configurations"
        " stopped by different rules are never compared. Where strategies are crossed with"
        " options (corrections, baselines, policies), only the pairs that were asked about are"
        " tested and corrected for: each option against the first, strategy by strategy; on a map,"
        " each point against the thesis’s softmax.</p>"
        "<p>Each statement of the thesis was turned into a test before looking: <b>never</b> and"
        " <b>always</b> allow no exception, and the Wilson interval must come within 5 % of it;"
        " <b>consistently</b> means with a probability above 90 %, <b>almost every time</b> above"
        " 80 %, <b>mostly</b> above 50 %. A statement <b>holds</b> where its interval or test says"
        f" so at the {level} level, <b>does not hold</b> where it says the contrary, and is"
        " <b>open</b> where these trials decide neither; the last column then says how many trials"
        " per configuration would settle it with 80 % power, if the present estimates were the"
        " truth. A statement of several parts holds where every part does, and fails where one"
        " part fails after Bonferroni’s correction. There is no correction across statements:"
        " among some thirty at this level, one wrong verdict would be no surprise.</p>"
        + _seconds(evidence)
    )


def _seconds(evidence: Evidence) -> str:
    if not evidence.timed:
        return (
            "<p><b>Seconds were not measured.</b> The thesis’s seconds are those of one trial run"
            " by itself, which a batch of trials does not tell; <code>python"
            " scripts/time_trials.py DIR</code> measures them, and the report made again shows"
            " them.</p>"
        )
    return (
        f"<p>Seconds are those of one trial run by itself, as in the thesis: {evidence.timed:,}"
        " trials were run again singly (<code>scripts/time_trials.py</code>) in one process on"
        " one thread, in random order over all configurations, after an untimed warm-up. Only the"
        " training is timed, not the start of the program. That each trial took exactly the"
        " frames of the original run was checked. Frames stand beside them, because they do not"
        " depend on the machine.</p>"
    )


def fairness(evidence: Evidence) -> str:
    """What the thesis tuned, and how to tune and report on different seeds."""
    shared = [s for s in evidence.shared if s.first[0] != s.second[0]]
    names = "; ".join(f"{'/'.join(s.first)} and {'/'.join(s.second)} ({s.count})" for s in shared)
    text = (
        f"<p>In these data, too, experiments share trials: {escape(names)}. They are one and the"
        " same trials, and are never pooled or counted as independent.</p>"
        if shared
        else ""
    )
    return (
        "<p>The thesis chose ε = 0.3 and the decay rate 0.99 on the very task that it then reports,"
        " and fitted nothing for softmax, whose temperature stayed 1. The tuned strategies thus"
        " had an advantage over the untuned one, and the reported scores of the chosen values are"
        " the best of a grid.</p>"
        f"{text}<p>To do it fairly, tune every strategy on one seed, and report on another one"
        " (different seeds share no trial):</p><pre>"
        "python scripts/train.py experiment=epsilon_grid seed=1 output_dir=tuning\n"
        "python scripts/train.py experiment=decay_grid seed=1 output_dir=tuning\n"
        "python scripts/train.py -m strategy=softmax strategy.temperature=0.25,0.5,1,2 \\\n"
        "    trials=20 seed=1 output_dir=tuning\n"
        "python scripts/report.py tuning\n"
        "# then, with the values chosen there:\n"
        "python scripts/train.py strategy=epsilon_greedy strategy.epsilon=0.4 seed=2"
        " output_dir=final\n"
        "python scripts/train.py strategy=softmax strategy.temperature=0.5 seed=2"
        " output_dir=final\n"
        "python scripts/report.py final</pre>"
    )


def group_facts(group: Group) -> str:
    """One line on what a group holds."""
    counts = sorted({len(c) for c in group.configurations})
    trials = f"{counts[0]:,}" if len(counts) == 1 else f"{counts[0]:,} to {counts[-1]:,}"
    n = len(group.configurations)
    what = "1 configuration" if n == 1 else f"{n} configurations"
    judged_by = group.configurations[0].judged_by
    whose = "" if judged_by == "training" else f" of {escape(judged_by)}"
    return (
        f"{what} × {trials} trials of {escape(group.environment)}, passed above"
        f" {group.threshold:g} over {group.window} episodes{whose}, cap {group.cap:,} iterations."
    )


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """A list of names and values; both are escaped here."""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in pairs)
    return f'<dl class="facts-list">{items}</dl>'
