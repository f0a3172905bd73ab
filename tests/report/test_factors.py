from trl_explore.report.factors import configuration_labels, natural_order, swept_parameter


def test_strategies_are_called_by_their_names(make):
    jobs = [make([200], strategy=s) for s in ("softmax", "decaying_epsilon_greedy")]
    assert list(configuration_labels(jobs).values()) == ["softmax", "decaying ε-greedy"]
    assert swept_parameter(jobs) is None


def test_values_of_one_parameter_are_named_by_it_and_ordered_by_number(make):
    jobs = [make([200], name=f"t{t}", parameters={"temperature": t}) for t in (10.0, 2.0, 0.5)]
    ordered = natural_order(jobs)
    labels = configuration_labels(ordered)
    assert [labels[c.name] for c in ordered] == ["T = 0.5", "T = 2", "T = 10"]
    assert swept_parameter(jobs) == "T"


def test_labels_that_would_be_equal_are_replaced_by_names(make):
    jobs = [make([200], name="one"), make([200], name="two")]
    assert configuration_labels(jobs) == {"one": "one", "two": "two"}


def test_schedules_are_named_with_their_parameter(make):
    def job(**schedule):
        target = f"trl_explore.strategies.schedules.{schedule.pop('kind', 'Linear')}"
        return make(
            [200], name=str(schedule), parameters={"temperature": {"_target_": target, **schedule}}
        )

    jobs = [job(initial=value, final=0.5) for value in (2.0, 5.0)]
    assert list(configuration_labels(jobs).values()) == [
        "T = 2 → 0.5 (linear)", "T = 5 → 0.5 (linear)"
    ]  # fmt: skip
    assert swept_parameter(jobs) == "T"
    jobs = [
        job(kind="Linear", initial=2.0),
        job(kind="Cosine", initial=2.0, final=1.0),
        job(kind="Exponential", initial=2.0, decay=0.9),
    ]
    assert list(configuration_labels(jobs).values()) == [
        "T = 2 → (linear)", "T = 2 → 1 (cosine)", "T = 2 → 0 (exponential, decay rate 0.9)"
    ]  # fmt: skip
    jobs = [make([200], name="fixed", parameters={"temperature": 1.0}), job(initial=2.0, final=0.5)]
    assert list(configuration_labels(jobs).values()) == ["T = 1", "T = 2 → 0.5 (linear)"]


def test_the_bias_of_another_strategy_is_named_with_its_parameter(make):
    def job(target, **parameters):
        strategy = {"_target_": f"trl_explore.strategies.{target}", **parameters}
        return make([200], name=target + str(parameters), assumes=strategy)

    plain = make([200], groups={"correction": "NoCorrection"})
    jobs = [plain, job("Argmax"), job("EpsilonGreedy", epsilon=0.3),
            job("DecayingEpsilonGreedy", decay=0.99)]  # fmt: skip
    assert list(configuration_labels(jobs).values()) == [
        "uncorrected", "bias of argmax", "bias of ε-greedy 0.3", "bias of decaying ε-greedy 0.99"
    ]  # fmt: skip
