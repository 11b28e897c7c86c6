# What else the report has, in R: learning, correlations with simulation metrics, further readings.
# analysis.R reads this file at its end. Bootstraps use the samples of operators that smooth-operator
# drew (rows_draws.csv), the test of correlations within operators its changes of signs
# (rows_signs.csv). Not here: Friedman's test by permutations, retargeters that never or always
# succeed, the six scales of the questionnaire one by one.

LIMITS <- c(@LIMITS@)
MARGINS <- c(@MARGINS@)
scopes <- c("pooled", sort(unique(trials$task), method = "radix"))
everybody <- unique(trials$retargeter)

# Bootstrap: how often each of the operators, in the order of their codes, is in each sample.
drawn_rows <- lapply(c(draws = "rows_draws.csv", signs = "rows_signs.csv"), function(name) {
  d <- table_of(name)
  if (is.null(d)) NULL else as.matrix(as.data.frame(lapply(d, as.numeric), check.names = FALSE))
})
drawn_of <- function(kind, operators, count) {  # samples x operators
  d <- drawn_rows[[kind]]
  d <- d[d[, "operators"] == operators & d[, "draw"] <= count, , drop = FALSE]
  unname(d[, 2 + seq_len(operators), drop = FALSE])
}
SAMPLES <- 2000; SAMPLES_OF_RHO <- 4000
limits_of <- function(draws) {
  if (!any(is.finite(draws))) return(c(NA, NA))
  quantile(draws[is.finite(draws)], c(0.025, 0.975), names = FALSE)
}
drawn <- function(value, draws) {
  ends <- limits_of(draws)
  data.frame(estimate = unname(value), lower = ends[1], upper = ends[2])
}
one_hot <- function(place, count) {
  m <- matrix(0, length(place), count)
  m[cbind(seq_along(place), place)] <- 1
  m
}

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

# Rank correlations of simulation metrics with outcomes, a point an operator with a retargeter.
metrics <- table_of("rows_metrics.csv")
if (!is.null(metrics)) {
  mean_of <- function(d, y) {
    round(tapply(d[[y]], list(d$operator, d$retargeter), mean), 9)
  }
  won <- trials[trials$success == 1 & !is.na(trials$time_s), ]
  outcomes <- list(success = mean_of(trials, "success"), time_s = mean_of(won, "time_s"))
  if (!is.null(tlx)) outcomes[[@WORKLOAD@]] <- mean_of(tlx[!is.na(tlx$workload), ], "workload")
  rho <- function(x, y) cor(rank(x), rank(y))
  ranks_in <- function(values, times) {  # mean ranks of points that each sample has so many times
    level <- match(values, sort(unique(values)))
    counts <- times %*% one_hot(level, max(level))
    below <- counts %*% upper.tri(diag(ncol(counts)))
    (below + (counts + 1) / 2)[, level, drop = FALSE]
  }
  rho_in <- function(x, y, times) {
    middle <- (rowSums(times) + 1) / 2
    a <- ranks_in(x, times) - middle; b <- ranks_in(y, times) - middle
    rowSums(times * a * b) / sqrt(rowSums(times * a^2) * rowSums(times * b^2))
  }
  correlated <- NULL
  for (metric in setdiff(colnames(metrics), c("operator", "retargeter"))) for (name in names(outcomes)) {
    table <- outcomes[[name]]
    p <- data.frame(operator = metrics$operator, retargeter = metrics$retargeter,
                    x = round(as.numeric(metrics[[metric]]), 9))
    inside <- p$operator %in% rownames(table) & p$retargeter %in% colnames(table)
    p <- p[inside, ]; p$y <- table[cbind(p$operator, p$retargeter)]
    p <- p[is.finite(p$x) & is.finite(p$y), ]
    if (nrow(p) < 4 || length(unique(p$operator)) < 2) next
    r <- rho(p$x, p$y); n <- nrow(p)
    if (is.na(r)) next
    reach <- qnorm(0.975) / sqrt(n - 3)
    centred <- function(v) ave(v, p$operator, FUN = function(one) rank(one) - mean(rank(one)))
    a <- centred(p$x); b <- centred(p$y)
    codes <- sort(unique(p$operator), method = "radix")
    times <- drawn_of("draws", length(codes), SAMPLES_OF_RHO)
    ends <- limits_of(rho_in(p$x, p$y, times[, match(p$operator, codes)]))
    sums <- rowsum(cbind(a * b, a^2, b^2), factor(p$operator, codes))
    inside_draws <- times %*% sums
    inside <- limits_of(inside_draws[, 1] / sqrt(inside_draws[, 2] * inside_draws[, 3]))
    turned <- drawn_of("signs", length(codes), SAMPLES_OF_RHO) %*% sums[, 1]
    as_far <- sum(abs(turned) >= abs(sum(sums[, 1])) - 1e-9)
    of_means <- sapply(split(p[c("x", "y")], p$retargeter), colMeans)
    correlated <- bind(correlated, data.frame(metric = metric, outcome = name, rho = r, n = n,
      operators = length(unique(p$operator)), p_t = two_sided(r * sqrt((n - 2) / (1 - r^2)), n - 2),
      ci_fisher_lcl = tanh(atanh(r) - reach), ci_fisher_ucl = tanh(atanh(r) + reach),
      ci_boot_operators_lcl = ends[1], ci_boot_operators_ucl = ends[2],
      within_rho = sum(a * b) / sqrt(sum(a^2) * sum(b^2)), within_n = n,
      within_lcl = inside[1], within_ucl = inside[2],
      within_p = (1 + as_far) / (1 + SAMPLES_OF_RHO),
      means_rho = rho(round(of_means["x", ], 9), round(of_means["y", ], 9)),
      means_n = ncol(of_means)))
  }
  if (!is.null(correlated)) {
    tested <- is.finite(correlated$within_rho)
    correlated$within_p[!tested] <- NA
    correlated$within_p_holm <- NA
    correlated$within_p_holm[tested] <- p.adjust(correlated$within_p[tested], "holm")
  }
  report("spearman", correlated, c("metric", "outcome"))
}

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
  d <- droplevels(d[d$retargeter %in% both_ends(d), ])
  d$t <- if (sd(d$index) > 0) as.numeric(scale(d$index)) else 0
  m <- compared(binary(d, "small-sample"), levels(d$retargeter))
  for (part in names(m)) say("full_success", paste0(scope, "/", part), m[[part]][[1]], m[[part]][-1])
})

# What each operator adds to the coefficients, corrected for the own leverage.
influence_of <- function(score, information, by_operator) {
  inverse <- solve(Reduce(`+`, information))
  sapply(names(by_operator), function(one) {
    own <- colSums(score[by_operator[[one]], , drop = FALSE])
    inverse %*% solve(diag(length(own)) - information[[one]] %*% inverse, own)
  })
}
hotelling <- function(values, covariance, operators) {
  q <- length(values)
  stopifnot("too few operators for a joint test" = operators > q)
  f <- drop(t(values) %*% solve(covariance, values)) * (operators - q) / ((operators - 1) * q)
  data.frame(f = f, df1 = q, df2 = operators - q, p = pf(f, q, operators - q, lower.tail = FALSE))
}

# Brant's test: do the retargeters' coefficients of both cuts agree? Two logits fitted together.
brant <- function(level, x, by_operator, others) {
  cuts <- lapply(2:3, function(cut) {
    full <- cbind(1, x); y <- as.numeric(level >= cut)
    m <- suppressWarnings(glm.fit(full, y, family = binomial(),
                                  control = glm.control(epsilon = 1e-14, maxit = 100)))
    stopifnot("separation at one of the cuts" = max(abs(m$coefficients)) < 20)
    p <- m$fitted.values
    information <- lapply(by_operator, function(i)
      crossprod(full[i, , drop = FALSE], (p * (1 - p))[i] * full[i, , drop = FALSE]))
    list(beta = m$coefficients, influence = influence_of(full * (y - p), information, by_operator))
  })
  place <- 1 + seq_len(others)
  apart <- (cuts[[2]]$influence - cuts[[1]]$influence)[place, , drop = FALSE]
  hotelling((cuts[[2]]$beta - cuts[[1]]$beta)[place], tcrossprod(apart), length(by_operator))
}

# The three scores as an ordered outcome: maximum likelihood, operators as clusters.
for (scope in scopes) if (requireNamespace("ordinal", quietly = TRUE)) tried(paste("ordinal,", scope), {
  d <- rows_of("success", scope, everybody)
  one_sided <- tapply(d$score, d$retargeter, function(y) length(unique(y)) == 1 && y[1] %in% c(0, 1))
  d <- droplevels(d[d$retargeter %in% names(one_sided)[one_sided %in% FALSE], ])
  d$t <- if (sd(d$index) > 0) as.numeric(scale(d$index)) else 0
  values <- sort(unique(d$score))
  stopifnot("not all three scores occur" = length(values) == 3)
  d$level <- factor(d$score)
  f <- as.formula(paste("level ~", paste(terms_of(d), collapse = " + ")))
  m <- ordinal::clm(f, data = d, control = ordinal::clm.control(gradTol = 1e-10))
  x <- model.matrix(as.formula(paste("~", paste(terms_of(d), collapse = " + "))), d)[, -1, drop = FALSE]
  theta <- unname(m$alpha); beta <- unname(m$beta); k <- as.integer(d$level)
  linear_part <- as.vector(x %*% beta)
  up <- c(-Inf, theta, Inf)[k + 1] - linear_part; low <- c(-Inf, theta, Inf)[k] - linear_part
  axes <- rbind(0, diag(2), 0)
  first <- cbind(axes[k + 1, ], ifelse(k < 3, -1, 0) * x)
  second <- cbind(axes[k, ], ifelse(k > 1, -1, 0) * x)
  chance <- plogis(up) - plogis(low)
  steep_up <- dlogis(up) / chance; steep_low <- dlogis(low) / chance
  bend <- function(z) 1 - 2 * plogis(z)
  score <- first * steep_up - second * steep_low
  by_operator <- split(seq_len(nrow(d)), d$operator)
  information <- lapply(by_operator, function(i) crossprod(score[i, , drop = FALSE]) -
    crossprod(first[i, , drop = FALSE], (steep_up * bend(up))[i] * first[i, , drop = FALSE]) +
    crossprod(second[i, , drop = FALSE], (steep_low * bend(low))[i] * second[i, , drop = FALSE]))
  covariance <- tcrossprod(influence_of(score, information, by_operator))
  df <- length(by_operator) - 1
  names_of <- levels(d$retargeter); others <- length(names_of) - 1
  grid <- function(name) {
    g <- matrix(0, nlevels(d$task), length(beta), dimnames = list(NULL, colnames(x)))
    if (paste0("retargeter", name) %in% colnames(g)) g[, paste0("retargeter", name)] <- 1
    for (j in seq_len(nlevels(d$task))) {
      own <- paste0("task", levels(d$task)[j])
      if (own %in% colnames(g)) g[j, own] <- 1
    }
    g
  }
  for (name in names_of) {
    g <- grid(name); steps <- diff(values)
    below <- plogis(outer(as.vector(-g %*% beta), theta, `+`))
    steep <- sweep(below * (1 - below), 2, steps, `*`)
    gradient <- c(-colMeans(steep), colMeans(rowSums(steep) * g))
    estimate <- max(values) - mean(below %*% steps)
    se <- sqrt(drop(t(gradient) %*% covariance %*% gradient))
    say("ordinal", paste0(scope, "/mean_score"), name, estimate = estimate, se = se, df = df,
        lower = estimate - qt(0.975, df) * se, upper = estimate + qt(0.975, df) * se,
        p = two_sided(estimate / se, df))
  }
  if (names_of[1] == baseline) {
    place <- 2 + seq_len(others); b <- beta[seq_len(others)]; v <- covariance[place, place, drop = FALSE]
    se <- sqrt(diag(v)); correlation <- cov2cor(v)
    p <- sapply(abs(b / se), function(one) 1 - within(one, correlation, df))
    half <- critical(correlation, df) * se; raw <- two_sided(b / se, df)
    say("ordinal", paste0(scope, "/odds_ratios"), names_of[-1], odds_ratio = exp(b),
        lower = exp(b - half), upper = exp(b + half), log_odds_ratio = b, se = se, df = df,
        p_raw = raw, p_dunnett = pmax(p, raw))
  }
  tried(paste("Brant's test,", scope),
        say("ordinal", scope, "proportional", brant(k, x, by_operator, others)))
})

# Time with failures: cumulative incidence (Aalen-Johansen), restricted mean time without success.
incidence_of <- function(d, event, limit) {
  state <- factor(event, c("none", "success", "competing"))
  m <- survival::survfit(survival::Surv(d$end, state) ~ 1)
  at <- function(time) {
    k <- findInterval(time, m$time)
    if (k == 0) 0 else m$pstate[k, which(m$states == "success")]
  }
  inside <- m$time < limit
  edges <- c(0, m$time[inside], limit)
  reached <- c(0, m$pstate[inside, which(m$states == "success")])
  list(mean = sum((1 - reached) * diff(edges)), at = at)
}
# The same of samples that have row i times[, i] times; event 1 is a success, 2 never one, 0 unknown.
incidence_in <- function(ends, event, limit, times) {
  at <- sort(unique(ends)); count <- length(at)
  member <- one_hot(match(ends, at), count)
  total <- times %*% member
  won <- times %*% (member * (event == 1)); ended <- times %*% (member * (event != 0))
  at_risk <- total %*% lower.tri(diag(count), diag = TRUE)
  left <- rep(1, nrow(times)); sum_so_far <- 0; reached <- matrix(0, nrow(times), count)
  for (j in seq_len(count)) {
    some <- pmax(at_risk[, j], 1)  # without anybody at risk nothing happens
    sum_so_far <- sum_so_far + left * won[, j] / some
    left <- left * (1 - ended[, j] / some)
    reached[, j] <- sum_so_far
  }
  reached[at_risk[, 1] == 0, ] <- NA
  share <- function(time) {
    k <- findInterval(time, at)
    if (k == 0) 0 * reached[, 1] else reached[, k]
  }
  inside <- at < limit
  waiting <- 1 - cbind(0 * reached[, 1], reached[, inside, drop = FALSE])
  list(mean = drop(waiting %*% diff(c(0, at[inside], limit))), at = share)
}
for (scope in scopes) if (requireNamespace("survival", quietly = TRUE)) tried(paste("time,", scope), {
  of_scope <- if (scope == "pooled") scopes[-1] else scope
  d <- trials[trials$task %in% of_scope & !(trials$success == 1 & is.na(trials$time_s)), ]
  d$end <- ifelse(d$success == 1, d$time_s, d$duration_s)
  dropped <- grepl("drop|lost|fell", tolower(ifelse(is.na(d$line), "", d$line)))
  d$given_up <- d$success == 0 & !dropped
  codes <- sort(unique(d$operator), method = "radix")
  times <- drawn_of("draws", length(codes), SAMPLES)
  parts <- list(); samples <- list()
  for (name in everybody) {
    cells <- lapply(of_scope, function(task) {
      own <- d[d$task == task & d$retargeter == name, ]
      limit <- LIMITS[[task]]; known <- all(is.finite(own$end))
      filled <- own; filled$end[!is.finite(filled$end)] <- limit
      usual <- incidence_of(filled, ifelse(own$success == 1, "success", "competing"), limit)
      gone <- if (known) incidence_of(own, ifelse(own$success == 1, "success",
        ifelse(own$given_up, "none", "competing")), limit)$mean else NA
      sample <- times[, match(own$operator, codes), drop = FALSE]
      drawn_usual <- incidence_in(filled$end, ifelse(own$success == 1, 1, 2), limit, sample)
      drawn_gone <- if (known) incidence_in(own$end, ifelse(own$success == 1, 1,
        ifelse(own$given_up, 0, 2)), limit, sample)$mean else NA * sample[, 1]
      list(c(restricted_mean = usual$mean, by_30_s = usual$at(min(30, limit)),
             by_limit = usual$at(limit), if_gone_on = gone),
           cbind(drawn_usual$mean, drawn_usual$at(min(30, limit)), drawn_usual$at(limit), drawn_gone))
    })
    parts[[name]] <- Reduce(`+`, lapply(cells, `[[`, 1)) / length(cells)
    samples[[name]] <- Reduce(`+`, lapply(cells, `[[`, 2)) / length(cells)
    colnames(samples[[name]]) <- names(parts[[name]])
  }
  for (what in names(parts[[1]])) for (name in everybody) {
    if (is.na(parts[[name]][[what]])) next
    say("time_to_success", paste0(scope, "/", what), name,
        drawn(parts[[name]][[what]], samples[[name]][, what]))
    apart <- c(restricted_mean = "difference", by_30_s = "by_30_s_difference",
               if_gone_on = "if_gone_on_difference")[what]
    if (name != baseline && !is.na(apart)) say("time_to_success", paste0(scope, "/", apart), name,
      drawn(parts[[name]][[what]] - parts[[baseline]][[what]],
            samples[[name]][, what] - samples[[baseline]][, what]))
  }
})

# Times on the log scale.
for (scope in scopes) tried(paste("log time,", scope), {
  d <- rows_of("time", scope, everybody)
  d$y <- log(d$y)
  m <- compared(linear(d, "small-sample"), levels(d$retargeter))
  means <- as.list(exp(m$emm$estimate)); names(means) <- m$emm$retargeter
  say("log_time", scope, "geometric_mean", as.data.frame(means, check.names = FALSE))
  if (!is.null(m$dunnett)) say("log_time", paste0(scope, "/ratios"), m$dunnett$retargeter,
    ratio = exp(m$dunnett$difference), lower = exp(m$dunnett$lower), upper = exp(m$dunnett$upper),
    df = m$dunnett$df, p_raw = m$dunnett$p_raw, p_dunnett = m$dunnett$p_dunnett, se = 1)
})

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

# Terms added to the models of all tasks together: retargeter x task, period, carry-over.
fitted_with <- function(outcome, d, more = NULL) {
  if (!is.null(more)) {
    colnames(more) <- seq_len(ncol(more))
    d$more <- more
  }
  terms <- c(terms_of(d), if (!is.null(more)) "more")
  added <- function(names) grep("^more", names)
  if (outcome == "success") {
    d$id <- as.integer(d$operator)
    m <- geeglm(as.formula(paste("y ~", paste(terms, collapse = " + "))), id = id, data = d,
                family = binomial, corstr = "exchangeable",
                control = geese.control(epsilon = 1e-12, maxit = 500))
    b <- coef(m); v <- mancl_derouen(m, model.matrix(m), d); g <- nlevels(droplevels(d$operator))
    of_retargeter <- function(name) {
      grid <- matrix(0, nlevels(d$task), length(b), dimnames = list(NULL, names(b)))
      grid[, "(Intercept)"] <- 1
      if (paste0("retargeter", name) %in% names(b)) grid[, paste0("retargeter", name)] <- 1
      for (k in seq_len(nlevels(d$task))) {
        own <- paste0("task", levels(d$task)[k]); if (own %in% names(b)) grid[k, own] <- 1
      }
      p <- as.vector(plogis(grid %*% b))
      list(mean = mean(p), gradient = colMeans(p * (1 - p) * grid))
    }
    all <- lapply(levels(d$retargeter), of_retargeter)
    joint <- function(columns) hotelling(b[columns], v[columns, columns], g)
    coefficient <- function(j) data.frame(estimate = b[[j]], se = sqrt(v[j, j]), df = g - 1)
    differences <- function() do.call(rbind, lapply(seq_along(all)[-1], function(j) {
      way <- all[[j]]$gradient - all[[1]]$gradient
      data.frame(estimate = all[[j]]$mean - all[[1]]$mean, se = sqrt(drop(t(way) %*% v %*% way)), df = g - 1)
    }))
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
    coefficient <- function(j) {
      s <- coef(summary(m, ddf = "Satterthwaite"))[j, ]
      data.frame(estimate = s[["Estimate"]], se = s[["Std. Error"]], df = s[["df"]])
    }
    differences <- function() {
      s <- coef(summary(m, ddf = "Satterthwaite"))[seq(2, nlevels(d$retargeter)), , drop = FALSE]
      data.frame(estimate = s[, "Estimate"], se = s[, "Std. Error"], df = s[, "df"])
    }
  }
  list(joint = function(count) joint(utils::tail(added(names_b), count)), differences = differences,
       last = function() coefficient(length(names_b)))
}
with_limits <- function(e) {
  half <- e$se * qt(0.975, e$df)
  cbind(e, lower = e$estimate - half, upper = e$estimate + half, p = two_sided(e$estimate / e$se, e$df))
}
dummies <- function(values, kept) {
  m <- sapply(kept[-1], function(one) as.numeric(values == one))
  sweep(m, 2, colMeans(m))
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
    say("interaction", outcome, "test", fitted_with(outcome, d, more)$joint(ncol(more)))
  })
  if (names_of[1] != baseline) next
  tried(paste("order,", outcome), {
    say("order", paste0(outcome, "/without"), names_of[-1], with_limits(fitted_with(outcome, d)$differences()))
    inside <- d
    inside$index <- as.numeric(if (outcome == "tlx") d$point else d$trial_in_block)
    inside$t <- if (sd(inside$index) > 0) as.numeric(scale(inside$index)) else 0
    number <- dummies(as.numeric(d$block), sort(unique(as.numeric(d$block))))
    period <- fitted_with(outcome, inside, number)
    say("order", paste0(outcome, "/with_period"), names_of[-1], with_limits(period$differences()))
    tried(paste("period,", outcome), say("order", outcome, "period", period$joint(ncol(number))))
    block <- unique(trials[c("operator", "task", "block", "retargeter")])
    place <- function(d, step) paste(d$operator, d$task, as.numeric(d$block) + step, sep = "\r")
    before <- block$retargeter[match(place(d, -1), place(block, 0))]
    before[is.na(before)] <- ""
    previous <- dummies(before, intersect(names_of, before)) * (before != "")
    carry <- fitted_with(outcome, inside, cbind(number, previous))
    say("order", paste0(outcome, "/with_carry_over"), names_of[-1], with_limits(carry$differences()))
    tried(paste("carry-over,", outcome), say("order", outcome, "carry_over", carry$joint(ncol(previous))))
  })
}

# What operators said of themselves, as a further term.
forms <- table_of("rows_forms.csv")
for (field in unique(forms$field)) for (outcome in c("success", "time", if (!is.null(tlx)) "tlx")) {
  tried(paste0(field, ", ", outcome), {
    d <- rows_of(outcome, "pooled", everybody)
    if (outcome == "success") d <- d[d$retargeter %in% both_ends(d), ]
    of_field <- forms[forms$field == field, ]
    d <- droplevels(d[d$operator %in% of_field$operator, ])
    d$t <- if (sd(d$index) > 0) as.numeric(scale(d$index)) else 0
    stopifnot("no rows of the baseline" = levels(d$retargeter)[1] == baseline)
    number <- of_field$kind[1] == "number"
    said <- of_field$answer[match(d$operator, of_field$operator)]
    more <- if (number) cbind(as.numeric(said) - mean(as.numeric(said))) else
      dummies(said, sort(unique(said), method = "radix"))
    others <- levels(d$retargeter)[-1]
    m <- fitted_with(outcome, d, more)
    where <- paste(field, outcome, sep = "/")
    say("covariates", paste0(where, "/without"), others, with_limits(fitted_with(outcome, d)$differences()))
    say("covariates", paste0(where, "/adjusted"), others, with_limits(m$differences()))
    if (number) say("covariates", where, "slope", with_limits(m$last()))
    say("covariates", where, "test", m$joint(ncol(more)))
  })
}

# Preference, and agreement with a second rater.
rankings <- table_of("rows_rankings.csv")
if (!is.null(rankings)) tried("preference", {
  in_order <- factor(rankings$operator, unique(rankings$operator))
  ranks <- tapply(as.numeric(rankings$rank), list(in_order, rankings$retargeter), mean)
  ranks <- ranks[stats::complete.cases(ranks), everybody, drop = FALSE]
  n <- nrow(ranks); k <- ncol(ranks); test <- friedman.test(ranks)
  wins <- sapply(seq_len(k), function(j) colSums(ranks < ranks[, j])) + 0.5  # [i, j]: i before j
  two <- combn(k, 2)
  x <- t(apply(two, 2, function(one) { v <- numeric(k); v[one] <- c(1, -1); v }))[, -1, drop = FALSE]
  m <- suppressWarnings(glm(cbind(wins[t(two)], wins[t(two[2:1, ])]) ~ x - 1, family = binomial,
                            control = list(epsilon = 1e-14)))
  strength <- exp(c(0, coef(m))); strength <- strength / sum(strength)
  times <- drawn_of("draws", n, SAMPLES)
  mean_ranks <- times %*% ranks / n
  won <- times %*% (k - ranks) + (k - 1) / 2
  now <- matrix(1 / k, nrow(won), k)
  for (round in 1:2000) {  # minorisation (Hunter 2004); every pair was compared n + 1 times
    following <- won / sapply(seq_len(k), function(i)
      rowSums((n + 1) / (now[, i] + now[, -i, drop = FALSE])))
    following <- following / rowSums(following)
    step <- max(abs(following - now)); now <- following
    if (step < 1e-9) break
  }
  for (j in seq_len(k)) {
    say("preference", "mean_rank", colnames(ranks)[j], drawn(colMeans(ranks)[j], mean_ranks[, j]))
    say("preference", "strength", colnames(ranks)[j], drawn(strength[j], now[, j]))
  }
  say("preference", "", "", friedman = unname(test$statistic), p_chi_squared = test$p.value,
      kendall_w = unname(test$statistic) / (n * (k - 1)), operators = n)
})
if (!is.null(trials$second_score)) tried("second rater", {
  d <- trials[!is.na(trials$second_score), ]
  scores <- c(0, 0.5, 1)
  codes <- sort(unique(d$operator), method = "radix")
  of_operator <- as.matrix(unclass(table(factor(d$operator, codes),  # operators x 9 pairs of scores
    factor(paste(d$score, d$second_score), outer(scores, scores, paste)))))
  samples <- drawn_of("draws", length(codes), SAMPLES) %*% of_operator
  kappa_of <- function(t, cells) {
    t <- matrix(t, 3)
    1 - sum(t * cells) / sum(outer(rowSums(t), colSums(t)) / sum(t) * cells)
  }
  kappa <- function(apart) {
    cells <- outer(scores, scores, apart)
    drawn(kappa_of(colSums(of_operator), cells), apply(samples, 1, kappa_of, cells))
  }
  of <- list(kappa = function(a, b) abs(a - b), kappa_unweighted = function(a, b) as.numeric(a != b),
             kappa_success = function(a, b) as.numeric((a >= 0.5) != (b >= 0.5)))
  for (name in names(of)) say("second_rater", "", name, kappa(of[[name]]))
})
report("readings", found, c("reading", "where", "term"))
