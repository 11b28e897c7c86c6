"""A method of your own: fingertips follow the human's, by damped least squares."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

import smooth_operator as so
from smooth_operator import AlignmentConfig, Hand
from smooth_operator.retargeting import Method, MethodConfig, MethodOutput


@dataclass(frozen=True)
class TipIkConfig(MethodConfig):
    """Settings; the alignment says how landmarks reach the palm frame."""

    iterations: int = 2
    damping: float = 2e-5  # m^2
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> "TipIk":
        return TipIk(hand, self)


@dataclass(frozen=True, eq=False)
class TipIk(Method):
    """One frame is Gauss-Newton steps from the last command, within the joint limits."""

    hand: Hand
    config: TipIkConfig

    @property
    def needs(self) -> tuple[int, ...]:  # without these landmarks the last command is held
        return tuple(so.LANDMARKS.index(name) for name in self.hand.tip_names)

    def init(self, seed: int) -> jax.Array:
        return jnp.asarray(self.hand.neutral, jnp.float32)

    def step(self, state, aligned, ticks):  # compiled; the state is all that is remembered
        rows = jnp.array([self.hand.tree.names.index(name) for name in self.hand.tip_names])

        def error(q: jax.Array) -> jax.Array:
            joints = self.hand.full_configuration_rows(list(q))  # coupled ones too
            points = self.hand.tree.positions(jnp.stack(joints))
            return (points[rows] - aligned[jnp.array(self.needs)]).ravel()

        q = state
        for _ in range(self.config.iterations):
            jacobian = jax.jacfwd(error)(q)
            hessian = jacobian.T @ jacobian + self.config.damping * jnp.eye(len(q))
            q = jnp.clip(q - jnp.linalg.solve(hessian, jacobian.T @ error(q)), *self.hand.limits.T)
        return q, MethodOutput(q, jnp.sum(error(q) ** 2))


recording = so.SyntheticOperator(seed=5, rate_hz=50).record(duration=2.0)
retargeter = so.Retargeter("mimic_p050", config=TipIkConfig())
commands, loss = retargeter.run(recording)
values = so.evaluate(so.assemble_trace(recording, commands, retargeter.hand))
print(f"direction {values['cosine_similarity']:.3f}, motion {values['motion_preservation']:.3f}")
assert values["cosine_similarity"] > 0.9
