# What else the report has, in R: learning, correlations with simulation metrics, further readings.
# analysis.R reads this file at its end. Bootstrap intervals and permutation tests are left out:
# they depend on random numbers.

LIMITS <- c(@LIMITS@)
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
    of_means <- sapply(split(p[c("x", "y")], p$retargeter), colMeans)
    correlated <- bind(correlated, data.frame(metric = metric, outcome = name, rho = r, n = n,
      operators = length(unique(p$operator)), p_t = two_sided(r * sqrt((n - 2) / (1 - r^2)), n - 2),
      ci_fisher_lcl = tanh(atanh(r) - reach), ci_fisher_ucl = tanh(atanh(r) + reach),
      within_rho = sum(a * b) / sqrt(sum(a^2) * sum(b^2)), within_n = n,
      means_rho = rho(round(of_means["x", ], 9), round(of_means["y", ], 9)),
      means_n = ncol(of_means)))
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
  inverse <- solve(Reduce(`+`, information))
  influence <- sapply(names(by_operator), function(one) {
    own <- colSums(score[by_operator[[one]], , drop = FALSE])
    inverse %*% solve(diag(length(own)) - information[[one]] %*% inverse, own)
  })
  covariance <- tcrossprod(influence); df <- length(by_operator) - 1
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
for (scope in scopes) if (requireNamespace("survival", quietly = TRUE)) tried(paste("time,", scope), {
  of_scope <- if (scope == "pooled") scopes[-1] else scope
  d <- trials[trials$task %in% of_scope & !(trials$success == 1 & is.na(trials$time_s)), ]
  d$end <- ifelse(d$success == 1, d$time_s, d$duration_s)
  dropped <- grepl("drop|lost|fell", tolower(ifelse(is.na(d$line), "", d$line)))
  d$given_up <- d$success == 0 & !dropped
  parts <- list()
  for (name in everybody) {
    each <- sapply(of_scope, function(task) {
      own <- d[d$task == task & d$retargeter == name, ]
      limit <- LIMITS[[task]]; known <- all(is.finite(own$end))
      filled <- own; filled$end[!is.finite(filled$end)] <- limit
      usual <- incidence_of(filled, ifelse(own$success == 1, "success", "competing"), limit)
      gone <- if (known) incidence_of(own, ifelse(own$success == 1, "success",
        ifelse(own$given_up, "none", "competing")), limit)$mean else NA
      c(restricted_mean = usual$mean, by_30_s = usual$at(min(30, limit)),
        by_limit = usual$at(limit), if_gone_on = gone)
    })
    parts[[name]] <- rowMeans(each)
  }
  for (what in rownames(each)) for (name in everybody) {
    say("time_to_success", paste0(scope, "/", what), name, estimate = parts[[name]][[what]])
    apart <- c(restricted_mean = "difference", by_30_s = "by_30_s_difference",
               if_gone_on = "if_gone_on_difference")[what]
    if (name != baseline && !is.na(apart)) say("time_to_success", paste0(scope, "/", apart), name,
      estimate = parts[[name]][[what]] - parts[[baseline]][[what]])
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
    joint <- function(columns) {
      q <- length(columns)
      f <- drop(t(b[columns]) %*% solve(v[columns, columns], b[columns])) * (g - q) / ((g - 1) * q)
      data.frame(f = f, df1 = q, df2 = g - q, p = pf(f, q, g - q, lower.tail = FALSE))
    }
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
    differences <- function() {
      s <- coef(summary(m, ddf = "Satterthwaite"))[seq(2, nlevels(d$retargeter)), , drop = FALSE]
      data.frame(estimate = s[, "Estimate"], se = s[, "Std. Error"], df = s[, "df"])
    }
  }
  list(joint = function(count) joint(utils::tail(added(names_b), count)), differences = differences)
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

# Preference, and agreement with a second rater.
rankings <- table_of("rows_rankings.csv")
if (!is.null(rankings)) tried("preference", {
  ranks <- with(rankings, tapply(as.numeric(rank), list(operator, retargeter), mean))
  ranks <- ranks[stats::complete.cases(ranks), everybody, drop = FALSE]
  n <- nrow(ranks); k <- ncol(ranks); test <- friedman.test(ranks)
  wins <- sapply(seq_len(k), function(j) colSums(ranks < ranks[, j])) + 0.5  # [i, j]: i before j
  two <- combn(k, 2)
  x <- t(apply(two, 2, function(one) { v <- numeric(k); v[one] <- c(1, -1); v }))[, -1, drop = FALSE]
  m <- suppressWarnings(glm(cbind(wins[t(two)], wins[t(two[2:1, ])]) ~ x - 1, family = binomial,
                            control = list(epsilon = 1e-14)))
  strength <- exp(c(0, coef(m))); strength <- strength / sum(strength)
  say("preference", "mean_rank", colnames(ranks), estimate = colMeans(ranks))
  say("preference", "strength", colnames(ranks), estimate = unname(strength))
  say("preference", "", "", friedman = unname(test$statistic), p_chi_squared = test$p.value,
      kendall_w = unname(test$statistic) / (n * (k - 1)), operators = n)
})
if (!is.null(trials$second_score)) tried("second rater", {
  d <- trials[!is.na(trials$second_score), ]
  kappa <- function(apart) {
    cells <- outer(c(0, 0.5, 1), c(0, 0.5, 1), apart)
    t <- table(factor(d$score, c(0, 0.5, 1)), factor(d$second_score, c(0, 0.5, 1)))
    1 - sum(t * cells) / sum(outer(rowSums(t), colSums(t)) / sum(t) * cells)
  }
  of <- list(kappa = function(a, b) abs(a - b), kappa_unweighted = function(a, b) as.numeric(a != b),
             kappa_success = function(a, b) as.numeric((a >= 0.5) != (b >= 0.5)))
  for (name in names(of)) say("second_rater", "", name, estimate = kappa(of[[name]]))
})
report("readings", found, c("reading", "where", "term"))
