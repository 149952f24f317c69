//! Time in the name of a file.

/// Formats a time in ns since the Unix epoch like `20261121T110405Z`.
pub(crate) fn utc_name(time_ns: u64) -> String {
    let seconds = time_ns / 1_000_000_000;
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    // Civil date from a day count: Howard Hinnant's `civil_from_days`, for years after 1970.
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let day_of_era = shifted % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_shifted + 2) / 5 + 1;
    let month = if month_shifted < 10 {
        month_shifted + 3
    } else {
        month_shifted - 9
    };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!(
        "{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z",
        second / 3600,
        second / 60 % 60,
        second % 60
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_carry_utc() {
        assert_eq!(utc_name(0), "19700101T000000Z");
        assert_eq!(utc_name(951_782_399_000_000_000), "20000228T235959Z");
        assert_eq!(utc_name(951_868_800_000_000_000), "20000301T000000Z");
        assert_eq!(utc_name(1_795_260_245_000_000_000), "20261121T112405Z");
    }
}
