# R's figures for time and workload in mode small-sample, as JSON: lme4, lmerTest, emmeans.
#
#     Rscript study_nested.R ROWS.csv ...
#
# Columns: y, retargeter, task, operator, index. Means and pairs at the mean index, tasks equal.
suppressMessages({library(lme4); library(lmerTest); library(emmeans)})
of <- function(path) {
  d <- read.csv(path, stringsAsFactors = FALSE)
  d$retargeter <- relevel(factor(d$retargeter), "dexpilot")
  d$task <- factor(d$task)
  d$operator <- factor(d$operator)
  d$t <- as.numeric(scale(d$index))
  fixed <- if (nlevels(d$task) > 1) "y ~ retargeter + task + t" else "y ~ retargeter + t"
  random <- "+ (1 | operator) + (1 | operator:retargeter)"
  if (nlevels(d$task) > 1) random <- paste(random, "+ (1 | operator:retargeter:task)")
  m <- suppressMessages(lmer(as.formula(paste(fixed, random)), d, REML = TRUE,
    control = lmerControl(optimizer = "bobyqa",
      optCtrl = list(rhoend = 1e-12, maxfun = 1e5), check.conv.singular = "ignore",
      calc.derivs = FALSE)))
  s <- coef(summary(m, ddf = "Satterthwaite"))
  e <- emmeans(m, "retargeter", at = list(t = 0), lmer.df = "satterthwaite",
    lmerTest.limit = 1e5, weights = "equal")
  es <- as.data.frame(e)
  ps <- as.data.frame(pairs(e, adjust = "none"))
  v <- as.data.frame(VarCorr(m))
  list(names = rownames(s), estimate = s[, "Estimate"], se = s[, "Std. Error"], df = s[, "df"],
    emm = es$emmean, emm_se = es$SE, emm_df = es$df,
    pair = ps$estimate, pair_se = ps$SE, pair_df = ps$df, pair_p = ps$p.value,
    log_likelihood = as.numeric(logLik(m)),
    variances = setNames(as.list(v$vcov), v$grp))
}
files <- commandArgs(TRUE)
found <- lapply(setNames(files, files), of)
cat(jsonlite::toJSON(found, digits = I(15), auto_unbox = TRUE))
