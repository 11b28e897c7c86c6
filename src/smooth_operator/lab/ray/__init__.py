"""Data sets of any size on Ray: a stateful class for ``map_batches``, and a resumable pipeline.

``retarget_corpus`` in ``corpus`` is the pipeline, ``RetargetClips`` in ``retarget_clips`` the class
for pipelines of your own. See research/docs/plan-20000-hours.md.
"""
