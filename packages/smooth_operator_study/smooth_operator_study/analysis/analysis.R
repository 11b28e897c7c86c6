# The same analysis in R: means, comparisons and coefficients of success, time and workload, each
# in both modes and all scopes, from the rows that smooth-operator analysed.
#
#     Rscript analysis.R [FOLDER]        # in the folder of the results, or with its name
#
# Packages: lme4, lmerTest, emmeans (time, workload), geepack (success), mvtnorm (Dunnett).
# It reads rows_trials.csv and rows_tlx.csv, fits what emm.csv lists (parts that were refused have
# no figures there), writes R_emm.csv, R_dunnett.csv, R_pairs.csv and R_coefficients.csv, and prints
# the largest difference from smooth-operator's tables of the same names without "R_". Then it does
# so with learning and with those readings that are models: success as a score of 1, equivalence,
# logarithms of times, and retargeter x task. Not here: whatever is drawn at random (bootstraps,
# permutations).

suppressMessages({
  library(lme4); library(lmerTest); library(geepack); library(emmeans); library(mvtnorm)
})
folder <- c(commandArgs(TRUE), ".")[1]
baseline <- @BASELINE@

# Spreadsheets would read some texts as formulas: those have an apostrophe in front.
plain <- function(x) if (is.character(x)) sub("^'([=+@\t\r-])", "\\1", x) else x
table_of <- function(name) {
  path <- file.path(folder, name)
  if (!file.exists(path)) return(NULL)
  d <- read.csv(path, stringsAsFactors = FALSE, na.strings = "", check.names = FALSE,
                encoding = "UTF-8", colClasses = "character")
  as.data.frame(lapply(d, plain), check.names = FALSE)
}
numeric_columns <- function(d, names) {
  for (name in intersect(names, colnames(d))) d[[name]] <- as.numeric(d[[name]])
  d
}
trials <- numeric_columns(table_of("rows_trials.csv"), c("success", "time_s", "trial_global", "score"))
tlx <- table_of("rows_tlx.csv")
if (!is.null(tlx)) tlx <- numeric_columns(tlx, c("workload", "index"))
fitted_parts <- table_of("emm.csv")

# Rows of one part: y, and t, the z-score of the trial's (questionnaire's) count.
rows_of <- function(outcome, scope, retargeters) {
  d <- if (outcome == "tlx") tlx else trials
  d$y <- switch(outcome, success = d$success, time = d$time_s, tlx = d$workload)
  d$index <- if (outcome == "tlx") d$index else d$trial_global
  if (outcome == "time") d <- d[d$success == 1, ]
  if (scope != "pooled") d <- d[d$task == scope, ]
  d <- d[!is.na(d$y) & d$retargeter %in% retargeters, ]
  levels_of <- function(x) sort(unique(x), method = "radix")
  first <- intersect(baseline, d$retargeter)
  d$retargeter <- factor(d$retargeter, c(first, setdiff(levels_of(d$retargeter), first)))
  d$task <- factor(d$task, levels_of(d$task))
  d$operator <- factor(d$operator, levels_of(d$operator))
  d$t <- d$index - mean(d$index)
  if (sd(d$index) > 0) d$t <- d$t / sd(d$index)
  d[order(d$operator), ]  # geeglm wants the rows of an operator together
}
terms_of <- function(d) {
  c("retargeter", if (nlevels(d$task) > 1) "task", if (sd(d$t) > 0) "t")
}

# Time and workload. Mode paper: a random intercept for each operator, tests by the normal
# distribution. Mode small-sample: also one for each operator with each retargeter and, over
# several tasks, for each block; Satterthwaite's degrees of freedom.
linear <- function(d, mode) {
  random <- "(1 | operator)"
  if (mode == "small-sample") random <- c(random, "(1 | operator:retargeter)",
    if (nlevels(d$task) > 1) "(1 | operator:retargeter:task)")
  f <- as.formula(paste("y ~", paste(c(terms_of(d), random), collapse = " + ")))
  m <- lmer(f, d, REML = TRUE, control = lmerControl(optimizer = "bobyqa",
    optCtrl = list(rhoend = 1e-12, maxfun = 1e5), check.conv.singular = "ignore",
    calc.derivs = FALSE))
  small <- mode == "small-sample"
  s <- coef(summary(m, ddf = if (small) "Satterthwaite" else "lme4"))
  at <- if (sd(d$t) > 0) list(t = 0) else list()
  e <- emmeans(m, "retargeter", at = at, weights = "equal", lmerTest.limit = 1e6,
    lmer.df = if (small) "satterthwaite" else "asymptotic")
  pairs_of <- as.data.frame(pairs(e, adjust = "none"))
  v <- as.data.frame(VarCorr(m))$vcov
  list(
    names = rownames(s), beta = s[, "Estimate"], beta_se = s[, "Std. Error"],
    beta_df = if (small) s[, "df"] else rep(Inf, nrow(s)),
    means = as.data.frame(e)$emmean, covariance = vcov(e), mean_df = as.data.frame(e)$df,
    pair_df = pairs_of$df, effect = function(a, b) (a - b) / sqrt(sum(v)))
}

# Success: population-averaged logistic regression. Mode paper: the sandwich covariance, normal
# distribution. Mode small-sample: Mancl and DeRouen (2001), t with operators - 1. Where a retargeter
# or task always or never succeeds, Firth's logistic regression.
binary <- function(d, mode) {
  f <- as.formula(paste("y ~", paste(terms_of(d), collapse = " + ")))
  d$id <- as.integer(d$operator)
  x <- model.matrix(f, d)
  levels <- c(one_sided(d, x, "retargeter"), one_sided(d, x, "task"))
  if (length(levels)) {
    m <- firth(x, d, levels)
    b <- m$b
    covariance <- m[[mode]]
  } else {
    m <- geeglm(f, id = id, data = d, family = binomial, corstr = "exchangeable",
                control = geese.control(epsilon = 1e-12, maxit = 500))
    b <- coef(m)
    covariance <- if (mode == "paper") m$geese$vbeta else mancl_derouen(m, x, d)
  }
  df <- if (mode == "paper") Inf else nlevels(d$operator) - 1
  # Means of probabilities over the tasks, with the delta method.
  of_retargeter <- function(name) {
    grid <- expand.grid(retargeter = name, task = levels(d$task))
    g <- matrix(0, nrow(grid), length(b), dimnames = list(NULL, names(b)))
    g[, "(Intercept)"] <- 1
    own <- paste0("retargeter", name)
    if (own %in% names(b)) g[, own] <- 1
    for (k in seq_len(nrow(grid))) {
      task <- paste0("task", grid$task[k])
      if (task %in% names(b)) g[k, task] <- 1
    }
    p <- as.vector(plogis(g %*% b))
    list(mean = mean(p), gradient = colMeans(p * (1 - p) * g))
  }
  found <- lapply(levels(d$retargeter), of_retargeter)
  gradient <- do.call(rbind, lapply(found, `[[`, "gradient"))
  count <- length(found)
  list(
    names = names(b), beta = unname(b), beta_se = sqrt(diag(covariance)),
    beta_df = rep(df, length(b)), means = sapply(found, `[[`, "mean"),
    covariance = gradient %*% covariance %*% t(gradient), mean_df = rep(df, count),
    pair_df = rep(df, choose(count, 2)), shares = TRUE,
    effect = function(a, b) 2 * asin(sqrt(a)) - 2 * asin(sqrt(b)))
}
# Levels of a factor without both outcomes: their rows, and the change of the coefficients that
# changes their log-odds alone.
one_sided <- function(d, x, factor) {
  of <- d[[factor]]
  if (nlevels(of) < 2) return(list())
  alike <- Filter(function(name) length(unique(d$y[of == name])) == 1, levels(of))
  lapply(alike, function(name) {
    direction <- setNames(numeric(ncol(x)), colnames(x))
    if (name == levels(of)[1]) {
      direction["(Intercept)"] <- 1
      direction[paste0(factor, levels(of)[-1])] <- -1
    } else direction[paste0(factor, name)] <- 1
    list(rows = of == name, direction = direction)
  })
}
# Firth (1993) with covariances clustered by operators; for levels without both outcomes the
# model's own variance of their log-odds is added.
firth <- function(x, d, levels) {
  b <- numeric(ncol(x))
  for (k in 1:500) {
    p <- as.vector(plogis(x %*% b))
    inverse <- solve(crossprod(x, p * (1 - p) * x))
    h <- p * (1 - p) * rowSums((x %*% inverse) * x)
    step <- as.vector(inverse %*% crossprod(x, d$y - p + h * (0.5 - p)))
    far <- max(abs(x %*% step))
    b <- b + step * min(1, 2 / far)
    if (far < 1e-12) break
  }
  own <- Reduce(`+`, lapply(levels, function(one) {
    mean <- colMeans(x[one$rows, , drop = FALSE])
    drop(mean %*% inverse %*% mean) * one$direction %o% one$direction
  }))
  parts <- lapply(split(seq_along(p), d$id), function(i) {
    list(dv = t(x[i, , drop = FALSE]), d = (p * (1 - p) * x)[i, , drop = FALSE], e = (d$y - p)[i])
  })
  meat <- Reduce(`+`, lapply(parts, function(one) tcrossprod(one$dv %*% one$e)))
  list(b = setNames(b, colnames(x)), paper = inverse %*% meat %*% inverse + own,
       "small-sample" = corrected(parts) + own)
}
mancl_derouen <- function(m, x, d) {
  mu <- as.vector(fitted(m))
  alpha <- m$geese$alpha
  groups <- split(seq_along(mu), d$id)
  corrected(lapply(groups, function(i) {
    a <- mu[i] * (1 - mu[i])
    r <- matrix(alpha, length(i), length(i)); diag(r) <- 1
    v <- solve(outer(sqrt(a), sqrt(a)) * r)  # but for the scale, which cancels
    list(dv = t(a * x[i, , drop = FALSE]) %*% v, d = a * x[i, , drop = FALSE], e = d$y[i] - mu[i])
  }))
}
corrected <- function(parts) {
  bread <- solve(Reduce(`+`, lapply(parts, function(one) one$dv %*% one$d)))
  meat <- Reduce(`+`, lapply(parts, function(one) {
    h <- one$d %*% bread %*% one$dv  # leverage of the operator on the own residuals
    u <- one$dv %*% solve(diag(length(one$e)) - h, one$e)
    u %*% t(u)
  }))
  bread %*% meat %*% bread
}

# P(|T_j| < x for all j): multivariate normal given the common chi, integrated over the chi.
legendre <- local({
  n <- 40; k <- seq_len(n - 1); off <- k / sqrt(4 * k^2 - 1)
  m <- matrix(0, n, n); m[cbind(k, k + 1)] <- off; m[cbind(k + 1, k)] <- off
  e <- eigen(m, symmetric = TRUE)
  list(x = e$values, w = 2 * e$vectors[1, ]^2)
})
within <- function(x, correlation, df) {
  if (nrow(correlation) == 1) return(if (is.finite(df)) 1 - 2 * pt(-x, df) else 1 - 2 * pnorm(-x))
  normal <- function(z) {
    how <- if (nrow(correlation) <= 3) Miwa(steps = 512) else if (nrow(correlation) == 4)
      Miwa(steps = 128) else GenzBretz(1e5, 1e-6, 0)
    if (z > 12) 1 else pmvnorm(rep(-z, nrow(correlation)), rep(z, nrow(correlation)),
                               corr = correlation, algorithm = how)[1]
  }
  if (!is.finite(df)) return(normal(x))
  ends <- sqrt(qchisq(c(1e-10, 1 - 1e-10), df) / df)
  s <- mean(ends) + diff(ends) / 2 * legendre$x
  density <- 2 * s * df * dchisq(df * s^2, df)
  sum(legendre$w * diff(ends) / 2 * density * sapply(x * s, normal))
}
critical <- function(correlation, df) {
  m <- nrow(correlation)
  ends <- if (is.finite(df)) qt(c(0.975, 1 - 0.024 / m), df) else qnorm(c(0.975, 1 - 0.024 / m))
  if (m == 1) return(ends[1])
  uniroot(function(x) within(x, correlation, df) - 0.95, ends, tol = 1e-7)$root
}
two_sided <- function(x, df) {
  df <- rep_len(df, length(x))
  ifelse(is.finite(df), 2 * pt(-abs(x), df), 2 * pnorm(-abs(x)))
}

# Means, pairs and comparisons with the baseline (Dunnett), of a fit.
compared <- function(m, names) {
  se <- sqrt(diag(m$covariance))
  reach <- se * ifelse(is.finite(m$mean_df), qt(0.975, m$mean_df), qnorm(0.975))
  ends <- cbind(m$means - reach, m$means + reach)
  if (isTRUE(m$shares)) {  # on the logit
    reach <- reach / (m$means * (1 - m$means))
    ends <- plogis(qlogis(m$means) + cbind(-reach, reach))
  }
  emm <- data.frame(retargeter = names, estimate = m$means, se = se, df = m$mean_df,
                    lower = ends[, 1], upper = ends[, 2])
  if (length(names) < 2) return(list(emm = emm))
  two <- combn(length(names), 2)
  i <- two[1, ]; j <- two[2, ]
  v <- m$covariance
  difference <- m$means[i] - m$means[j]
  se <- sqrt(v[cbind(i, i)] + v[cbind(j, j)] - 2 * v[cbind(i, j)])
  raw <- two_sided(difference / se, m$pair_df)
  pairs <- data.frame(pair = paste(names[i], names[j], sep = "-"), difference = difference, se = se,
    df = m$pair_df, statistic = difference / se, p_raw = raw, p_holm = p.adjust(raw, "holm"),
    effect = m$effect(m$means[i], m$means[j]))
  if (names[1] != baseline) return(list(emm = emm, pairs = pairs))
  of <- which(i == 1)  # baseline - other; Dunnett's are other - baseline
  l <- cbind(-1, diag(length(of)))
  correlation <- cov2cor(l %*% v %*% t(l))
  x <- -difference[of] / se[of]
  df <- m$pair_df[of]
  p <- mapply(function(one, f) 1 - within(abs(one), correlation, f), x, df)
  half <- se[of] * sapply(df, function(f) critical(correlation, f))
  most <- if (isTRUE(m$shares)) 1 else Inf
  list(emm = emm, pairs = pairs, dunnett = data.frame(retargeter = names[-1],
    difference = -difference[of], se = se[of], df = df, statistic = x, p_raw = raw[of],
    p_dunnett = pmax(p, raw[of]), lower = pmax(-difference[of] - half, -most),
    upper = pmin(-difference[of] + half, most),
    effect = m$effect(m$means[-1], m$means[1])))
}

# Writes R_NAME.csv, and prints how far it is from NAME.csv.
report <- function(name, found, key) {
  if (is.null(found)) return(invisible())
  write.csv(found, file.path(folder, paste0("R_", name, ".csv")), row.names = FALSE, na = "")
  ours <- table_of(paste0(name, ".csv"))
  if (is.null(ours)) return(invisible())
  both <- merge(found, ours, by = key, suffixes = c("", ".ours"))
  columns <- intersect(setdiff(colnames(found), key), colnames(ours))
  far <- sapply(columns, function(column) {
    a <- both[[column]]; b <- as.numeric(both[[paste0(column, ".ours")]])
    apart <- abs(a - b)
    scale <- if (grepl("^p", column)) 1 else if (grepl("lower|upper", column)) both$se else abs(b)
    max(c(0, (apart / scale)[is.finite(a) & is.finite(b) & apart > 0]), na.rm = TRUE)
  })
  cat(sprintf("%s: %d of %d rows; largest difference (p: absolute, limits: of the standard error)\n",
              name, nrow(both), nrow(ours)))
  print(signif(far, 2))
}

parts <- unique(fitted_parts[, c("mode", "outcome", "scope")])
tables <- list(emm = NULL, dunnett = NULL, pairs = NULL, coefficients = NULL)
for (k in seq_len(nrow(parts))) {
  where <- parts[k, ]
  own <- merge(fitted_parts, where)
  d <- rows_of(where$outcome, where$scope, own$retargeter)
  m <- if (where$outcome == "success") binary(d, where$mode) else linear(d, where$mode)
  found <- c(compared(m, levels(d$retargeter)), list(coefficients = data.frame(name = m$names,
    estimate = m$beta, se = m$beta_se, df = m$beta_df, p = two_sided(m$beta / m$beta_se, m$beta_df))))
  for (name in names(found)) {
    rows <- data.frame(where, found[[name]], row.names = NULL, check.names = FALSE)
    tables[[name]] <- rbind(tables[[name]], rows)
  }
}
label <- c(emm = "retargeter", dunnett = "retargeter", pairs = "pair", coefficients = "name")
for (name in names(tables)) report(name, tables[[name]], c("mode", "outcome", "scope", label[[name]]))

MARGINS <- c(@MARGINS@)
scopes <- c("pooled", sort(unique(trials$task), method = "radix"))
everybody <- unique(trials$retargeter)

# Learning: slopes over one count of trials, with a random intercept of operators alone.
slopes <- NULL
fixed_terms <- function(d) c("retargeter", if (nlevels(d$task) > 1) "task")
linear_slope <- function(d) {
  f <- as.formula(paste("y ~", paste(c(fixed_terms(d), "x", "(1 | operator)"), collapse = " + ")))
  m <- lmer(f, d, REML = TRUE, control = lmerControl(optimizer = "bobyqa",
    optCtrl = list(rhoend = 1e-12, maxfun = 1e5), check.conv.singular = "ignore",
    calc.derivs = FALSE))
  s <- coef(summary(m, ddf = "Satterthwaite"))["x", ]
  x <- model.matrix(m); e <- d$y - as.vector(x %*% fixef(m))
  v <- as.data.frame(VarCorr(m))$vcov
  covariance <- corrected(lapply(split(seq_len(nrow(d)), droplevels(d$operator)), function(i) {
    one <- x[i, , drop = FALSE]
    list(dv = t(one) %*% solve(diag(length(i)) + v[1] / v[2]), d = one, e = e[i])
  }))
  df <- nlevels(droplevels(d$operator)) - 1
  z <- s[["Estimate"]] / s[["Std. Error"]]
  robust <- sqrt(covariance["x", "x"])
  data.frame(slope = s[["Estimate"]], se = s[["Std. Error"]], z = z, p_z = two_sided(z, Inf),
    df_satterthwaite = s[["df"]], p_satterthwaite = s[["Pr(>|t|)"]], se_mancl_derouen = robust,
    df = df, p_t = two_sided(s[["Estimate"]] / robust, df), n = nrow(d), sd_x = sd(d$index))
}
logistic_slope <- function(d) {
  f <- as.formula(paste("y ~", paste(c(fixed_terms(d), "x"), collapse = " + ")))
  d$id <- as.integer(d$operator)
  m <- geeglm(f, id = id, data = d, family = binomial, corstr = "exchangeable",
              control = geese.control(epsilon = 1e-12, maxit = 500))
  x <- model.matrix(m); p <- as.vector(fitted(m)); k <- which(colnames(x) == "x")
  slope <- unname(coef(m)["x"]); robust <- m$geese$vbeta
  spread <- p * (1 - p)
  gradient <- slope * colMeans(spread * (1 - 2 * p) * x)
  gradient[k] <- gradient[k] + mean(spread)
  md <- sqrt(mancl_derouen(m, x, d)[k, k]); df <- nlevels(droplevels(d$operator)) - 1
  se <- sqrt(robust[k, k])
  data.frame(slope_logit = slope, se = se, z = slope / se, p_z = two_sided(slope / se, Inf),
    ame_prob_per_unit = slope * mean(spread),
    ame_se = sqrt(drop(t(gradient) %*% robust %*% gradient)), se_mancl_derouen = md, df = df,
    p_t = two_sided(slope / md, df), n = nrow(d), sd_x = sd(d$index))
}
both_ends <- function(d) {  # retargeters that neither always nor never succeed
  r <- tapply(d$y, d$retargeter, function(y) length(unique(y)) > 1)
  names(r)[!is.na(r) & r]
}
bind <- function(a, b) {  # rows with other columns
  if (is.null(a)) return(b)
  for (name in setdiff(colnames(a), colnames(b))) b[[name]] <- NA
  for (name in setdiff(colnames(b), colnames(a))) a[[name]] <- NA
  rbind(a, b[colnames(a)])
}
learning <- table_of("learning.csv")
for (k in seq_len(NROW(learning))) {
  where <- learning[k, c("scope", "index", "outcome")]
  if (is.null(learning$n) || isTRUE(!is.na(learning$refused[k]))) next
  d <- rows_of(where$outcome, where$scope, everybody)
  source_of <- if (where$outcome == "tlx") tlx else trials
  column <- c(trial_global = "trial_global", trial_in_block = "trial_in_block", tlx_index = "index",
              in_block = "point")[[where$index]]
  d$index <- as.numeric(d[[column]])
  if (where$outcome == "success") {
    d <- droplevels(d[d$retargeter %in% both_ends(d), ])
  }
  d$x <- d$index - mean(d$index)
  found <- if (where$outcome == "success") logistic_slope(d) else linear_slope(d)
  slopes <- bind(slopes, data.frame(where, found, row.names = NULL))
}
report("learning", slopes, c("scope", "index", "outcome"))

# Further readings: rows of one long table, by reading, where and term.
found <- NULL
say <- function(reading, where, term, ...) {
  rows <- data.frame(reading = reading, where = where, term = term, ..., row.names = NULL,
                     check.names = FALSE)
  found <<- bind(found, rows)
}
tried <- function(what, expression) tryCatch(expression, error = function(error)
  cat(sprintf("%s: %s\n", what, conditionMessage(error))))

# Success as a score of 1.
for (scope in scopes) tried(paste("full success,", scope), {
  d <- rows_of("success", scope, everybody)
  d$y <- as.numeric(d$score >= 1)
  m <- compared(binary(d, "small-sample"), levels(d$retargeter))
  for (part in names(m)) say("full_success", paste0(scope, "/", part), m[[part]][[1]], m[[part]][-1])
})

# Logarithms of times.
for (scope in scopes) tried(paste("log time,", scope), {
  d <- rows_of("time", scope, everybody)
  d$y <- log(d$y)
  m <- compared(linear(d, "small-sample"), levels(d$retargeter))
  for (part in names(m)) say("log_time", paste0(scope, "/", part), m[[part]][[1]], m[[part]][-1])
})

# Joint test of several coefficients, their covariance estimated from operators.
hotelling <- function(values, covariance, operators) {
  q <- length(values)
  stopifnot("too few operators for a joint test" = operators > q)
  f <- drop(t(values) %*% solve(covariance, values)) * (operators - q) / ((operators - 1) * q)
  data.frame(f = f, df1 = q, df2 = operators - q, p = pf(f, q, operators - q, lower.tail = FALSE))
}

# Equivalence: two one-sided tests of every pair; those with the baseline are other - baseline.
pairs_found <- tables$pairs[tables$pairs$mode == "small-sample", ]
for (part in split(pairs_found, list(pairs_found$outcome, pairs_found$scope), drop = TRUE)) {
  ends <- combn(levels(rows_of(part$outcome[1], part$scope[1],
    fitted_parts$retargeter[fitted_parts$mode == "small-sample" & fitted_parts$outcome == part$outcome[1] &
                            fitted_parts$scope == part$scope[1]])$retargeter), 2)
  turned <- ends[1, ] == baseline
  x <- ifelse(turned, -1, 1) * part$difference
  label <- ifelse(turned, paste(ends[2, ], ends[1, ], sep = "-"), paste(ends[1, ], ends[2, ], sep = "-"))
  half <- part$se * ifelse(is.finite(part$df), qt(0.95, part$df), qnorm(0.95))
  margin <- if (part$outcome[1] %in% names(MARGINS)) MARGINS[[part$outcome[1]]] else NA
  p <- pt((abs(x) - margin) / part$se, part$df)
  p_holm <- rep(NA, length(p)); p_holm[turned] <- p.adjust(p[turned], "holm")
  say("equivalence", paste(part$outcome[1], part$scope[1], sep = "/"), label, difference = x,
      se = part$se, df = part$df, lower = x - half, upper = x + half, p = unname(p),
      p_holm = p_holm, smallest_margin = pmax(abs(x - half), abs(x + half)))
}

# Retargeter x task, added to the models of all tasks together: a joint test.
joint_test <- function(outcome, d, more) {
  colnames(more) <- seq_len(ncol(more))
  d$more <- more
  terms <- c(terms_of(d), "more")
  if (outcome == "success") {
    d$id <- as.integer(d$operator)
    m <- geeglm(as.formula(paste("y ~", paste(terms, collapse = " + "))), id = id, data = d,
                family = binomial, corstr = "exchangeable",
                control = geese.control(epsilon = 1e-12, maxit = 500))
    b <- coef(m); v <- mancl_derouen(m, model.matrix(m), d); g <- nlevels(droplevels(d$operator))
    joint <- function(columns) hotelling(b[columns], v[columns, columns], g)
    names_b <- names(b)
  } else {
    random <- c("(1 | operator)", "(1 | operator:retargeter)",
                if (nlevels(d$task) > 1) "(1 | operator:retargeter:task)")
    m <- lmer(as.formula(paste("y ~", paste(c(terms, random), collapse = " + "))), d, REML = TRUE,
      control = lmerControl(optimizer = "bobyqa", optCtrl = list(rhoend = 1e-12, maxfun = 1e5),
                            check.conv.singular = "ignore", calc.derivs = FALSE))
    names_b <- names(fixef(m))
    joint <- function(columns) {
      t <- contestMD(m, diag(length(names_b))[columns, , drop = FALSE], ddf = "Satterthwaite")
      data.frame(f = t[["F value"]], df1 = t[["NumDF"]], df2 = t[["DenDF"]], p = t[["Pr(>F)"]])
    }
  }
  joint(grep("^more", names_b))
}

for (outcome in c("success", "time", if (!is.null(tlx)) "tlx")) {
  d <- rows_of(outcome, "pooled", everybody)
  if (outcome == "success") d <- droplevels(d[d$retargeter %in% both_ends(d), ])
  d$t <- if (sd(d$index) > 0) as.numeric(scale(d$index)) else 0
  names_of <- levels(d$retargeter)
  tried(paste("interaction,", outcome), if (nlevels(d$task) > 1) {
    cells <- expand.grid(task = levels(d$task)[-1], retargeter = names_of[-1],
                         stringsAsFactors = FALSE)
    more <- mapply(function(task, name) as.numeric(d$task == task & d$retargeter == name),
                   cells$task, cells$retargeter)
    say("interaction", outcome, "test", joint_test(outcome, d, more))
  })
}

report("readings", found, c("reading", "where", "term"))

# A Bayesian reading, if you want one (package brms, minutes): the probability that a retargeter is
# better, and partial pooling of operators.
#
# library(brms)
# d <- rows_of("time", "pooled", unique(trials$retargeter))
# m <- brm(y ~ retargeter + task + t + (1 | operator) + (1 | operator:retargeter) +
#            (1 | operator:retargeter:task), d, family = lognormal())
# hypothesis(m, paste0("retargeter", levels(d$retargeter)[2], " < 0"))
# b <- brm(y ~ retargeter + task + t + (1 | operator) + (1 | operator:retargeter),
#          rows_of("success", "pooled", unique(trials$retargeter)), family = bernoulli())
