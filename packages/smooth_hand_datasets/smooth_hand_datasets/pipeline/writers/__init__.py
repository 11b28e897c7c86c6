"""Output formats of data sets: LeRobot, WebDataset, Parquet, SPIDER, FlashDexRetarget."""
