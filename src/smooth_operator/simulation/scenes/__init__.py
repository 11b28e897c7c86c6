"""Scenes of the user study's tasks, for any hand."""

from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, ScenePart, SceneState
from smooth_operator.simulation.scenes.task_scenes import SCENES, scene_for

__all__ = ["SCENES", "Scene", "ScenePart", "ScenePhysics", "SceneState", "scene_for"]
