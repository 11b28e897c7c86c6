# R's figures for cumulative incidence and restricted means, as JSON: survival, cmprsk.
#
#     Rscript study_survival.R ROWS.csv ...
#
# Columns: time, event (0 censored, 1 success, 2 competing), and limit, the same in all rows. Times
# at which the incidence is given: an eighth of the limit, two eighths, ..., the limit.
suppressMessages({library(survival); library(cmprsk)})
of <- function(path) {
  d <- read.csv(path)
  limit <- d$limit[1]
  at <- limit * (1:8) / 8
  state <- factor(d$event, 0:2, c("none", "success", "competing"))
  m <- survfit(Surv(d$time, state) ~ 1)  # Aalen-Johansen
  share <- summary(m, times = at, extend = TRUE)$pstate[, m$states == "success"]
  # Mean time in each state up to the limit; without success: at the start, or lost to the other.
  inside <- summary(m, rmean = limit)$table
  mean_of <- inside[, grep("rmean", colnames(inside))]
  won <- mean_of[grep("success", rownames(inside))]
  gray <- timepoints(cuminc(d$time, d$event), at)$est[1, ]  # the same estimate, Gray's program
  gray[is.na(gray)] <- max(gray, na.rm = TRUE)  # after the last row
  # One kind of event: Kaplan and Meier.
  alone <- survfit(Surv(time, event == 1) ~ 1, d)
  list(at = at, incidence = share, incidence_cmprsk = unname(gray),
       restricted_mean = unname(limit - won),
       kaplan_meier = 1 - summary(alone, times = at, extend = TRUE)$surv,
       restricted_mean_alone = unname(summary(alone, rmean = limit)$table["rmean"]))
}
files <- commandArgs(TRUE)
found <- lapply(setNames(files, sub("[.]csv$", "", basename(files))), of)
cat(jsonlite::toJSON(found, digits = I(15), auto_unbox = TRUE, pretty = TRUE))
