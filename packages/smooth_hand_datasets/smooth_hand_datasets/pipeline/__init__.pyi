from smooth_hand_datasets.pipeline.request import DatasetRequest as DatasetRequest
from smooth_hand_datasets.pipeline.request import Limits as Limits
from smooth_hand_datasets.pipeline.retargeting import Recipe as Recipe
from smooth_hand_datasets.pipeline.run import make_dataset as make_dataset
