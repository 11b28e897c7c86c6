"""Programs on the calling thread, and which methods want XLA's pool to have one."""

import os

import jax

from smooth_operator.compilation.start import dispatch_here
from smooth_operator.retargeting.presets import method_config


def test_the_pool_starts_with_one_thread_and_the_environment_is_left_as_it_was(monkeypatch):
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    monkeypatch.delenv("NPROC", raising=False)
    seen: list[str | None] = []
    monkeypatch.setattr(jax, "devices", lambda: seen.append(os.environ.get("PJRT_NPROC")))
    dispatch_here(one_thread=True)
    assert seen == ["1"]
    assert "PJRT_NPROC" not in os.environ
    dispatch_here()
    monkeypatch.setenv("NPROC", "4")  # the user's own choice
    dispatch_here(one_thread=True)
    assert seen == ["1"]


def test_only_a_wide_sampler_wants_more_threads():
    assert method_config("smooth", None).one_thread
    assert method_config("sbr", None).one_thread
    assert method_config("dexpilot", None).one_thread
    assert not method_config("sbr", "paper").one_thread
