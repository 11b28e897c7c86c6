"""Training of learning-based methods, in JAX and on a CPU; so far GeoRT. Nothing here prints."""

from smooth_operator.errors import require

require("training GeoRT", "lab", "optax")

from smooth_operator.lab.training.data import GeortTraining as GeortTraining
from smooth_operator.lab.training.data import TrainingData as TrainingData
from smooth_operator.lab.training.data import synthetic_recordings as synthetic_recordings
from smooth_operator.lab.training.data import training_data as training_data
from smooth_operator.lab.training.loop import LOSSES as LOSSES
from smooth_operator.lab.training.loop import GeortTrainer as GeortTrainer
from smooth_operator.lab.training.loop import TrainingSession as TrainingSession
from smooth_operator.lab.training.loop import TrainingState as TrainingState
from smooth_operator.lab.training.loop import read_checkpoint as read_checkpoint
from smooth_operator.lab.training.loop import write_checkpoint as write_checkpoint
